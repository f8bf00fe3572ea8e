"""The deployment files of a service of several machines: parsed, checked by their schemas, and run without a container daemon.

    python3 -m venv env && env/bin/pip install pyyaml check-jsonschema kubernetes-validate
    env/bin/python checks/service/manifests.py --program target/release/wandless --s3 s3s-fs --capture SESSION

`kubectl kustomize` builds the manifests where it is installed, else their files are read one by one. Every service of
`docker/compose.scale.yaml` is started by its own command and environment: PostgreSQL and the S3 server from this machine in place of their
images, ports on the loopback in place of the names of containers, nginx with the file's own configuration.
"""

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile

import yaml

from cluster import ObjectStore, Postgres, find, free_port
from harness import Failed, get, require, sha256, until, wandless

ROOT = os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "..")
COMPOSE = [os.path.join(ROOT, "docker", name) for name in ("compose.scale.yaml", "compose.yaml")]
KUBERNETES = os.path.join(ROOT, "docker", "kubernetes")

#: What the person who starts the file sets.
VARIABLES = {"POSTGRES_PASSWORD": "a-password", "S3_ACCESS_KEY": "GK0123456789abcdef01234567", "S3_SECRET_KEY": 64 * "5"}


def beside(name):
    """A program of this Python's environment."""
    return os.path.join(os.path.dirname(sys.executable), name)


def run(*words, **options):
    return subprocess.run(words, capture_output=True, text=True, **options)


def compose_files(options):
    """The compose files satisfy the specification's schema."""
    done = run(beside("check-jsonschema"), "--builtin-schema", "vendor.compose-spec", *COMPOSE)
    require(done.returncode == 0, done.stdout + done.stderr)
    return f"{len(COMPOSE)} files"


def manifests():
    """The objects that `kubectl apply -k` sends."""
    if shutil.which("kubectl"):
        built = run("kubectl", "kustomize", KUBERNETES)
        require(built.returncode == 0, built.stderr)
        return built.stdout
    print("SKIPPED: kustomize, because kubectl is not installed; the files are read one by one", flush=True)
    with open(os.path.join(KUBERNETES, "kustomization.yaml")) as file:
        names = yaml.safe_load(file)["resources"]
    return "\n---\n".join(open(os.path.join(KUBERNETES, name)).read() for name in names)


def kubernetes(options):
    """The manifests satisfy the schemas of Kubernetes, and every part is there."""
    text = manifests()
    with tempfile.NamedTemporaryFile("w", suffix=".yaml") as file:
        file.write(text)
        file.flush()
        done = run(beside("kubernetes-validate"), "--strict", file.name)
    require(done.returncode == 0 and "passed" in done.stdout + done.stderr, done.stdout + done.stderr)
    objects = [document for document in yaml.safe_load_all(text) if document]
    kinds = [document["kind"] for document in objects]
    for kind, n in {"Job": 1, "Deployment": 5, "HorizontalPodAutoscaler": 1, "ScaledObject": 4, "PodDisruptionBudget": 2,
                    "ServiceMonitor": 1, "NetworkPolicy": 1}.items():
        require(kinds.count(kind) == n, f"{kinds.count(kind)} objects of the kind {kind}, expected {n}")
    deployments = {document["metadata"]["name"]: document for document in objects if document["kind"] == "Deployment"}
    for document in [*deployments.values(), *(document for document in objects if document["kind"] == "Job")]:
        pod = document["spec"]["template"]["spec"]
        for container in pod["containers"]:
            sizes = container["resources"]
            require(sizes["requests"] == sizes["limits"], f"{container['name']}: requests differ from limits")
            known_command(options, container["args"])
        require(all("emptyDir" in volume for volume in pod["volumes"]), "a volume is not scratch")
    for scaled in (document for document in objects if document["kind"] == "ScaledObject"):
        name = scaled["spec"]["scaleTargetRef"]["name"]
        require(name in deployments, f"a ScaledObject scales {name}, which is not a deployment")
        settings = {one["name"]: one["value"] for one in deployments[name]["spec"]["template"]["spec"]["containers"][0]["env"]}
        query = scaled["spec"]["triggers"][0]["metadata"]["query"]
        require(f'wandless_work_wanted{{class="{settings["WANDLESS_WORKER__CLASS"]}"}}' in query, f"{name}: {query}")
        check_settings(options, settings)
    config = next(document for document in objects if document["kind"] == "ConfigMap")["data"] if "ConfigMap" in kinds else {}
    check_settings(options, {name: value for name, value in config.items() if name.startswith("WANDLESS_")})
    return f"{len(objects)} objects"


def known_command(options, words):
    """The program understands the command, whatever it would do."""
    done = run(options.program, *words, "--help")
    require(done.returncode == 0, f"{words}: {done.stderr}")


def check_settings(options, settings):
    """The program takes these variables."""
    given = {**os.environ, "WANDLESS_STORE__URL": "postgres://a@b/c", "WANDLESS_BLOBS__URL": "s3://a/b", **settings}
    done = run(options.program, "serve", "--print-settings", env=given)
    require(done.returncode == 0, f"{settings}: {done.stderr}")


class Composed:
    """The services of the compose file as processes of this machine."""

    def __init__(self, options):
        self.options = options
        with open(COMPOSE[0]) as file:
            self.file = interpolated(yaml.safe_load(file), VARIABLES)
        self.services = self.file["services"]
        self.folder = tempfile.mkdtemp(prefix="wandless-compose-")
        self.processes, self.ports = [], {}
        self.postgres = self.objects = None

    def start(self):
        given = self.services["postgres"]["environment"]
        self.postgres = Postgres(durable=False)
        self.postgres.ask(f"CREATE ROLE {given['POSTGRES_USER']} LOGIN PASSWORD '{given['POSTGRES_PASSWORD']}'", "postgres")
        self.postgres.ask(f"CREATE DATABASE {given['POSTGRES_DB']} OWNER {given['POSTGRES_USER']}", "postgres")
        self.objects = ObjectStore(self.options.s3, *self.bucket())
        migrated = run(*self.command("migrate"), env=self.environment("migrate"))
        require(migrated.returncode == 0 and "has the tables of" in migrated.stdout, f"migrate: {migrated.stderr}")
        key = run(self.options.program, "key", "create", "--scopes", "read,write,metrics", env=self.environment("api-1"))
        require(key.returncode == 0, f"key create: {key.stderr}")
        nodes = [name for name, service in self.services.items() if service.get("command", [""])[0] == "serve"]
        for name in nodes:
            self.ports[name] = free_port()
            self.spawn(self.command(name), {**self.environment(name), "WANDLESS_LISTEN": f"127.0.0.1:{self.ports[name]}"})
        for name in nodes:
            require(until(lambda name=name: ready(self.ports[name]), 60), f"{name} does not get ready")
        self.start_proxy()
        return key.stdout.strip(), nodes

    def bucket(self):
        """Bucket, access key and secret of the S3 server, which are those that the nodes use."""
        given, used = self.services["objects"]["environment"], self.services["api-1"]["environment"]
        keys = [given["GARAGE_DEFAULT_BUCKET"], given["GARAGE_DEFAULT_ACCESS_KEY"], given["GARAGE_DEFAULT_SECRET_KEY"]]
        bucket = used["WANDLESS_BLOBS__URL"].removeprefix("s3://").split("/")[0]
        require(keys == [bucket, used["AWS_ACCESS_KEY_ID"], used["AWS_SECRET_ACCESS_KEY"]], "the nodes and the S3 server differ in bucket or key")
        return keys

    def command(self, name):
        return [self.options.program, *self.services[name]["command"]]

    def environment(self, name):
        """The service's own variables, with ports of this machine in place of the containers' names."""
        given = {key: str(value) for key, value in self.services[name]["environment"].items()}
        given["WANDLESS_STORE__URL"] = given["WANDLESS_STORE__URL"].replace("@postgres/", f"@127.0.0.1:{self.postgres.port}/")
        require(given["AWS_ENDPOINT"] == "http://objects:3900", f"the endpoint is {given['AWS_ENDPOINT']}")
        given.update(self.objects.environment)
        if not self.objects.environment:
            given["WANDLESS_BLOBS__URL"] = self.objects.url
        given["WANDLESS_LIMITS__TRUSTED_PROXIES"] = '["127.0.0.1"]'
        data = os.path.join(self.folder, name)
        os.makedirs(data, exist_ok=True)
        return {**os.environ, **given, "WANDLESS_DATA": data, "WANDLESS_LOG": "error"}

    def spawn(self, command, environment=None):
        log = open(os.path.join(self.folder, f"log-{len(self.processes)}"), "w")
        self.processes.append(subprocess.Popen(command, env=environment, stdout=log, stderr=log))

    def start_proxy(self):
        """nginx with the configuration of the file; without it the API nodes are asked in turn."""
        text = self.file["configs"]["proxy"]["content"]
        nginx = shutil.which("nginx") or shutil.which("/usr/sbin/nginx")
        if not nginx:
            print("SKIPPED: the proxy, because nginx is not installed; the first API node takes its place", flush=True)
            self.ports["proxy"] = self.ports["api-1"]
            return
        for name, port in self.ports.items():
            text = text.replace(f"{name}:8700", f"127.0.0.1:{port}")
        self.ports["proxy"] = free_port()
        text = text.replace("listen 80;", f"listen 127.0.0.1:{self.ports['proxy']}; access_log {self.folder}/access.log seen;")
        seen = "log_format seen '$upstream_addr $status';"
        places = " ".join(f"{kind}_temp_path {self.folder}/{kind};" for kind in ("client_body", "proxy", "fastcgi", "uwsgi", "scgi"))
        with open(os.path.join(self.folder, "nginx.conf"), "w") as file:
            file.write(f"daemon off; pid {self.folder}/nginx.pid; error_log {self.folder}/nginx.log; events {{}}\nhttp {{ {seen} {places}\n{text}\n}}\n")
        self.spawn([nginx, "-p", self.folder, "-c", os.path.join(self.folder, "nginx.conf")])
        require(until(lambda: ready(self.ports["proxy"]), 20), "the proxy does not answer")

    def answered_by(self):
        """API nodes behind the proxy and how many requests each has answered."""
        with open(os.path.join(self.folder, "access.log")) as file:
            answers = [line.split()[0] for line in file if line.strip()]
        names = {f"127.0.0.1:{port}": name for name, port in self.ports.items()}
        return {names[address]: answers.count(address) for address in sorted(set(answers))}

    def remove(self):
        for process in reversed(self.processes):
            process.terminate()
        for process in self.processes:
            try:
                process.wait(40)
            except subprocess.TimeoutExpired:
                process.kill()
        for server in (self.objects, self.postgres):
            if server:
                server.remove()
        shutil.rmtree(self.folder, ignore_errors=True)


def ready(port):
    try:
        return get(port, "/readyz")[0] == 200
    except OSError:
        return False


def interpolated(value, variables):
    """Puts in the variables of a compose file: `${NAME}`, `${NAME:-default}`, `${NAME:?message}`; `$$` is a `$`."""
    if isinstance(value, dict):
        return {key: interpolated(one, variables) for key, one in value.items()}
    if isinstance(value, list):
        return [interpolated(one, variables) for one in value]
    if not isinstance(value, str):
        return value

    def found(match):
        if match.group(0) == "$$":
            return "$"
        name, default = match.group(1), match.group(2)
        require(name in variables or (default or "").startswith("-"), f"the variable {name} is not set")
        return variables.get(name, (default or "")[1:])

    return re.sub(r"\$\$|\$\{(\w+)(?::(-[^}]*|\?[^}]*))?\}", found, value)


def steps(options):
    """Every service of the compose file starts, and a capture goes through both API nodes."""
    composed = Composed(options)
    try:
        key, nodes = composed.start()
        url = f"http://127.0.0.1:{composed.ports['proxy']}"
        out = os.path.join(composed.folder, "result")
        done = run(options.program, "submit", options.capture, "--server", url, "--out", out, *options.option, env={**os.environ, "WANDLESS_KEY": key})
        require(done.returncode in (0, 3), f"submit: {done.stderr}")
        client = wandless.Client(url, key=key)
        (job,) = client.jobs()
        for file in client.manifest(job["id"])["files"]:
            with open(os.path.join(out, file["name"]), "rb") as written:
                require(sha256(written.read()) == file["sha256"], f"{file['name']} has other bytes")
        alerts = check_alerts(composed, nodes, key)
        answered = composed.answered_by() if composed.ports["proxy"] != composed.ports["api-1"] else {}
        require(not answered or set(answered) == {"api-1", "api-2"}, f"answers: {answered}")
        return f"{len(nodes)} nodes ready; verdict {job['quality']['verdict']}, answers by {answered}; {alerts}"
    finally:
        composed.remove()


def check_alerts(composed, nodes, key):
    """Every figure of the alerts and of the autoscaling exists, and one node leads."""
    pages = {name: page(composed.ports[name], key) for name in nodes}
    with open(os.path.join(ROOT, "docker", "alerts.yaml")) as file:
        rules = [rule for group in yaml.safe_load(file)["groups"] for rule in group["rules"]]
    for rule in rules:
        require(rule["annotations"]["summary"] and rule["alert"], f"incomplete: {rule}")
        for name in re.findall(r"wandless_\w+", rule["expr"]):
            base = re.sub(r"_(total|count|sum|bucket)$", "", name)
            require(any(f"# TYPE {base} " in text for text in pages.values()), f"{rule['alert']} asks for {name}, which no node has")
    leaders = sum(text.count("\nwandless_leader 1") for text in pages.values())
    require(leaders == 1, f"{leaders} leaders")
    require(any('wandless_work_wanted{class="0"} 0' in text for text in pages.values()), "no node has wandless_work_wanted")
    return f"figures of {len(rules)} alerts exist, 1 leader"


def page(port, key):
    import urllib.request
    request = urllib.request.Request(f"http://127.0.0.1:{port}/metrics", headers={"Authorization": f"Bearer {key}"})
    with urllib.request.urlopen(request, timeout=30) as answer:
        return answer.read().decode()


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--program", default="target/release/wandless")
    parser.add_argument("--s3", default=shutil.which("s3s-fs"), help="the program s3s-fs")
    parser.add_argument("--capture", required=True, help="a session, as a folder or a file")
    parser.add_argument("--option", action="append", default=[], help="a flag of `wandless submit`; can be repeated")
    options = parser.parse_args()
    options.program = os.path.abspath(options.program)
    if not find("initdb"):
        print("SKIPPED: PostgreSQL is not installed", flush=True)
        sys.exit(0)
    failed = False
    for row in (compose_files, kubernetes, steps):
        try:
            print(f"{row.__name__}: {row(options)}", flush=True)
        except (Failed, wandless.Problem, KeyError) as fault:
            failed = True
            print(f"{row.__name__}: FAULT {fault}", flush=True)
    print("FAILED" if failed else "passed")
    sys.exit(int(failed))


if __name__ == "__main__":
    main()
