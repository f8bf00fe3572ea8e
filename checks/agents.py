"""`wandless mcp` with the reference client library: python checks/agents.py WANDLESS WORK (pip install mcp)."""

import asyncio
import json
import os
import pathlib
import subprocess
import sys
import time
import urllib.request

from mcp import ClientSession, StdioServerParameters, stdio_client

PROGRAM, WORK = os.path.abspath(sys.argv[1]), pathlib.Path(sys.argv[2])
PORT = 20000 + os.getpid() % 20000
URL = f"http://127.0.0.1:{PORT}"
TOOLS = {"submit_session", "correct_job", "list_options", "list_jobs", "follow_job", "cancel_job", "read_report", "export_result",
         "download_result"}


def wait_for_service():
    for _ in range(300):
        try:
            urllib.request.urlopen(f"{URL}/healthz", timeout=1)
            return
        except OSError:
            time.sleep(0.1)
    sys.exit("the service does not answer")


async def call(session, tool, arguments, **rest):
    """The structured content of a call, which also is its text."""
    result = (await session.call_tool(tool, arguments, **rest)).model_dump(by_alias=True)
    assert not result["isError"], result
    assert json.loads(result["content"][0]["text"]) == result["structuredContent"]
    return result["structuredContent"]


async def refused(session, tool, arguments, expected):
    result = (await session.call_tool(tool, arguments)).model_dump(by_alias=True)
    assert result["isError"] and expected in result["content"][0]["text"], result


async def followed(session, job):
    seen = []

    async def on_progress(progress, total, message):
        seen.append(progress)

    for _ in range(100):
        state = await call(session, "follow_job", {"job": job, "wait_s": 20}, progress_callback=on_progress)
        if state["is_final"]:
            assert state["state"] == "succeeded", state
            assert seen and seen == sorted(seen), seen
            return state
    raise AssertionError("the job did not end")


async def journey(session):
    started = await session.initialize()
    named = started.model_dump(by_alias=True)
    assert named["serverInfo"]["name"] == "wandless" and named["capabilities"]["tools"] is not None
    listed = (await session.list_tools()).model_dump(by_alias=True)["tools"]
    assert {tool["name"] for tool in listed} == TOOLS, listed
    await session.send_ping()
    options = await call(session, "list_options", {})
    assert any(option["name"] == "corrections" for option in options["options"])

    job = (await call(session, "submit_session", {"session": str(WORK / "take"), "options": {"up_axis": "z"}}))["job"]
    await followed(session, job)
    report = await call(session, "read_report", {"job": job})
    assert report["verdict"] in ("pass", "warn", "reject") and len(report["cameras"]) == 4 and len(report["people"]) == 2
    exported = await call(session, "export_result", {"job": job, "formats": ["glb", "bvh"]})
    assert {"scene.glb", "0.bvh"} <= set(exported["files"])
    downloaded = await call(session, "download_result", {"job": job, "folder": str(WORK / "result")})
    assert pathlib.Path(downloaded["folder"], "scene.glb").is_file()

    rename = [{"action": "rename", "person": 0, "name": "Ada"}]
    corrected = (await call(session, "correct_job", {"job": job, "corrections": rename}))["job"]
    await followed(session, corrected)
    people = (await call(session, "read_report", {"job": corrected}))["people"]
    assert people[0]["name"] == "Ada", people
    assert {entry["job"] for entry in (await call(session, "list_jobs", {"state": "succeeded"}))["jobs"]} == {job, corrected}

    await refused(session, "submit_session", {"session": str(WORK / "nothing")}, "nothing")
    await refused(session, "submit_session", {"session": str(WORK / "take"), "options": {"poeple": 2}}, "poeple")
    await refused(session, "read_report", {"job": "../sessions"}, "not the id of a job")
    await refused(session, "read_report", {}, "job is missing")
    await refused(session, "cancel_job", {"job": job}, "already ended")
    await refused(session, "download_result", {"job": job, "folder": str(WORK / "result")}, "not empty")


async def main():
    server = StdioServerParameters(command=PROGRAM, args=["mcp", "--server", URL])
    async with stdio_client(server) as (read, write), ClientSession(read, write) as session:
        await journey(session)


WORK.mkdir()
simulate = [PROGRAM, "simulate", "--out", str(WORK / "take"), "--people", "2", "--views", "4", "--frames", "60", "--seed", "3"]
subprocess.run(simulate, check=True, capture_output=True)
service = subprocess.Popen([PROGRAM, "serve", "--data", str(WORK / "data"), "--listen", f"127.0.0.1:{PORT}"], stderr=subprocess.DEVNULL)
try:
    wait_for_service()
    asyncio.run(main())
    print("ok: the journey of an agent")
finally:
    service.terminate()
    service.wait()
