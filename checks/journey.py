"""The way of a new user: journey.py WORK [--program WANDLESS]

Runs the commands of README.md, as they stand there, in an empty folder: clone, build, demonstration, detector, capture, solve, Blender, viewer, further
formats. A program that writes OpenPose's files of a simulated capture takes the place of the detector, a script that writes `session.json` that of the
editor. With `--program`, a built program takes the place of the build. Blender: `blender`, or its Python module in BLENDER_PYTHON.
"""

import argparse
import json
import os
import pathlib
import re
import shlex
import shutil
import signal
import subprocess
import sys
import time
import urllib.request

HERE = pathlib.Path(__file__).resolve()
REPOSITORY = HERE.parents[1]
MAX_COMMANDS = 12
#: Commands that serve until they are interrupted, and the line with the address that they serve at last.
SERVING = {"wandless demo": r"viewer, while.*(http://\S+)", "wandless view": r"(http://\S+)"}
#: Seconds that a serving command may need to be ready.
PATIENCE_S = 900


def commands_of(heading):
    """The lines of the first shell block below a heading of README.md, without comments."""
    text = (REPOSITORY / "README.md").read_text()
    section = text.split(f"\n## {heading}\n", 1)[1].split("\n## ", 1)[0]
    block = re.search(r"```sh\n(.*?)```", section, re.S)[1]
    return [re.split(r"\s{2,}#", line)[0].strip() for line in block.splitlines() if line.strip()]


def in_order():
    """All commands in the order of a first day, with the names that a user would choose."""
    build, demo, reconstruct, view, export = commands_of("Quickstart")
    detect, edit, solve, blender = commands_of("From your videos")
    named = lambda line, **names: re.sub(r"\b[A-Z]{4,}\b", lambda word: names.get(word[0], word[0]), line)
    return [
        f"git clone --quiet {shlex.quote(str(REPOSITORY))} wandless && cd wandless",
        build,
        "cd ..",
        demo,
        detect,
        edit,
        solve,
        blender,
        named(reconstruct, SESSION="capture", RESULT="again"),
        named(view, RESULT="result"),
        named(export, RESULT="result", MORE="more"),
    ]


def write_tool(folder, name, lines):
    path = folder / name
    path.write_text("\n".join(["#!/usr/bin/env python3", *lines]) + "\n")
    path.chmod(0o755)


def make_tools(folder, truth, program):
    """The programs of other people that README's commands call."""
    folder.mkdir()
    write_tool(folder, "openpose.bin", [
        "import json, pathlib, sys",
        "words = dict(zip(sys.argv[1::2], sys.argv[2::2]))",
        "name, out = pathlib.Path(words['--video']).stem, pathlib.Path(words['--write_json'])",
        "out.mkdir(parents=True)",
        f"frames = json.loads(pathlib.Path({str(truth)!r}, 'poses', name + '.json').read_text())['frames']",
        "for frame in frames:",
        "    people = [{'person_id': [-1], 'pose_keypoints_2d': [x for point in person['keypoints'] for x in point]} for person in frame['people']]",
        "    text = json.dumps({'version': 1.3, 'people': people})",
        "    (out / f\"{name}_{frame['frame']:012d}_keypoints.json\").write_text(text)",
    ])
    write_tool(folder, "an_editor", [
        "import json, pathlib, sys",
        f"session = json.loads(pathlib.Path({str(truth)!r}, 'session.json').read_text())",
        "cameras = [{key: camera[key] for key in ('id', 'width', 'height', 'K')} for camera in session['cameras']]",
        "pathlib.Path(sys.argv[1]).write_text(json.dumps({'fps': session['fps'], 'cameras': cameras}))",
    ])
    if program is not None:
        write_tool(folder, "cargo", [
            "import os, pathlib, shutil, sys",
            "assert sys.argv[1:] == ['build', '--release'], sys.argv",
            "pathlib.Path('target/release').mkdir(parents=True)",
            f"shutil.copy({str(program)!r}, 'target/release/wandless')",
        ])
    inside = HERE.parent / "exports" / "opened.py"
    blender, module = shutil.which("blender"), os.environ.get("BLENDER_PYTHON")
    if blender:
        call = [blender, "--background", "--factory-startup", "--python-exit-code", "1", "--python", str(inside), "--"]
    elif module:
        call = [module, str(inside), "--"]
    else:
        return False
    write_tool(folder, "blender", ["import subprocess, sys", f"sys.exit(subprocess.run({call!r} + sys.argv[2:]).returncode)"])
    return True


def take(program, folder):
    """A simulated capture of three cameras with the names that README uses."""
    words = ["--people", "2", "--views", "3", "--frames", "150", "--seed", "4", "--convention", "body25", "--tracks", "none"]
    subprocess.run([program, "simulate", "--out", folder, *words], check=True, stdout=subprocess.DEVNULL)
    path = folder / "session.json"
    session = json.loads(path.read_text())
    for number, camera in enumerate(session["cameras"], 1):
        (folder / "poses" / f"{camera['id']}.json").rename(folder / "poses" / f"cam{number}.json")
        camera["id"] = f"cam{number}"
    path.write_text(json.dumps(session))


class Shell:
    """One shell for all commands: what one of them exports or changes is there for the next."""

    def __init__(self, folder, tools):
        environment = {**os.environ, "PATH": f"{tools}:{os.environ['PATH']}", "EDITOR": "an_editor"}
        self.process = subprocess.Popen(["bash"], cwd=folder, env=environment, text=True, bufsize=1, stdin=subprocess.PIPE,
                                        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, start_new_session=True)

    def run(self, command):
        """Runs a command to its end; returns its exit code and output."""
        self.process.stdin.write(f"{command}\necho \"exit:$?\"\n")
        return self.rest()

    def serve(self, command, pattern):
        """Runs a command until it names an address that answers, then interrupts it."""
        watch = "(while kill -0 $serving 2>/dev/null; do sleep 0.5; done; echo 'it ended')"
        self.process.stdin.write(f"{command} &\nserving=$!\n{watch} &\n")
        output, deadline = "", time.monotonic() + PATIENCE_S
        while time.monotonic() < deadline:
            line = self.process.stdout.readline()
            output += line
            address = re.search(pattern, line)
            if address or line.startswith("it ended"):
                break
        if not address:
            return 1, output + "it named no address"
        is_answered = self.answers(address[1])
        # A job in the background of a shell without job control ignores SIGINT.
        self.process.stdin.write("kill -TERM $serving; wait $serving; code=$?; [ $code = 143 ] && code=0; echo \"exit:$code\"\n")
        code, rest = self.rest()
        return code or int(not is_answered), output + rest

    def answers(self, address):
        try:
            return urllib.request.urlopen(address.split("#")[0].rstrip(".,"), timeout=10).status == 200
        except OSError:
            return False

    def rest(self):
        output = ""
        for line in self.process.stdout:
            end = re.search(r"exit:(\d+)$", line.strip())
            if end:
                return int(end[1]), output + line[: end.start()]
            output += line
        return 1, output

    def close(self):
        os.killpg(self.process.pid, signal.SIGKILL)


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("work", type=pathlib.Path)
    parser.add_argument("--program", type=pathlib.Path)
    words = parser.parse_args()
    work = words.work.resolve()
    (work / "home").mkdir(parents=True)
    program = words.program and words.program.resolve()
    simulator = program or shutil.which("wandless") or sys.exit("without --program a wandless on the PATH simulates the capture")
    take(simulator, work / "truth")
    has_blender = make_tools(work / "tools", work / "truth", program)
    commands, failed, began = in_order(), 0, time.monotonic()
    shell = Shell(work / "home", work / "tools")
    for number, command in enumerate(commands, 1):
        if command.startswith("blender") and not has_blender:
            print(f"skipped {number}: {command}: Blender is not installed", flush=True)
            continue
        start = time.monotonic()
        pattern = next((pattern for name, pattern in SERVING.items() if command.startswith(name)), None)
        code, output = shell.serve(command, pattern) if pattern else shell.run(command)
        print(f"{'ok' if code == 0 else 'FAILED'} {number} ({time.monotonic() - start:.0f} s): {command}", flush=True)
        if code != 0:
            print(output[-3000:])
            failed += 1
            break
    shell.close()
    print(f"{'ok' if len(commands) <= MAX_COMMANDS else 'FAILED'}: {len(commands)} commands, {time.monotonic() - began:.0f} s")
    sys.exit(1 if failed or len(commands) > MAX_COMMANDS else 0)


main()
