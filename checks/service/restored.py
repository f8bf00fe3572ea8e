"""Row of `scale.py`: `wandless verify --undelete` on a bucket with versions. Needs moto (pip install 'moto[server,s3]')."""

import importlib.util
import os
import subprocess
import sys

from cluster import Cluster, free_port, is_open
from harness import require, take, until
from states import FIXED

KEYS = {"AWS_ACCESS_KEY_ID": "check", "AWS_SECRET_ACCESS_KEY": "check-secret", "AWS_REGION": "us-east-1", "AWS_ALLOW_HTTP": "true"}


def brought_back(options):
    """Objects that were removed after the second to which the database was restored are brought back; without versions it says so."""
    if not importlib.util.find_spec("moto"):
        return "skipped: moto is not installed"
    import boto3
    cluster, port = Cluster(options.program, options.s3), free_port()
    server = subprocess.Popen([sys.executable, "-m", "moto.server", "-H", "127.0.0.1", "-p", str(port)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        require(until(lambda: is_open(port), 30), "moto does not answer")
        environment = {**KEYS, "AWS_ENDPOINT": f"http://127.0.0.1:{port}", "WANDLESS_BLOBS__URL": "s3://versions/service"}
        s3 = boto3.client("s3", endpoint_url=environment["AWS_ENDPOINT"], region_name="us-east-1",
                          aws_access_key_id="check", aws_secret_access_key="check-secret")
        s3.create_bucket(Bucket="versions")
        node = cluster.node("all", **environment)
        client = node.client()
        job = client.submit(client.upload(take(8))["id"], FIXED)["id"]
        client.wait(job)
        before = client.manifest(job)["files"]
        node.stop()

        def verify(*words):
            given = {**os.environ, **environment, "WANDLESS_STORE__URL": cluster.postgres.url("wandless"), "WANDLESS_LOG": "error"}
            done = subprocess.run([options.program, "verify", *words], capture_output=True, text=True, env=given)
            return done.returncode, done.stdout + done.stderr

        code, text = verify("--undelete")
        require(code == 1 and "keeps no versions" in text, f"without versions: {code} {text}")
        s3.put_bucket_versioning(Bucket="versions", VersioningConfiguration={"Status": "Enabled"})
        keys = [one["Key"] for one in s3.list_objects_v2(Bucket="versions")["Contents"] if "/clock" not in one["Key"]]
        for key in keys:  # written again, so that each has a version
            s3.put_object(Bucket="versions", Key=key, Body=s3.get_object(Bucket="versions", Key=key)["Body"].read())
        removed, changed = keys[::2], keys[1]
        for key in removed:
            s3.delete_object(Bucket="versions", Key=key)
        s3.put_object(Bucket="versions", Key=changed, Body=b"other bytes")
        code, text = verify()
        require(code == 1 and f"{len(removed) + 1} damaged" in text, f"verify: {code} {text}")
        code, text = verify("--undelete")
        require(code == 0 and f"{len(removed) + 1} brought back, 0 damaged" in text, f"undelete: {code} {text}")
        require(verify()[0] == 0, "an object is still missing")
        fresh = cluster.node("api", **environment).client()
        require(fresh.manifest(job)["files"] == before, "the manifest differs")
        for file in before:
            fresh.artifact(job, file["name"])
        return f"{len(removed)} of {len(keys)} objects removed, one overwritten: all brought back and read"
    finally:
        server.kill()
        server.wait()
        cluster.remove()
