"""Row 11: checks `docker/Dockerfile` without a Docker daemon. The files that its steps copy must be sufficient for a build;
the image must not run as root; the size of its layers must stay below the limit.

    python3 checks/service/image.py --program target/release/wandless
"""

import os
import re
import shutil
import subprocess
import tempfile

from harness import Faults, arguments

ROOT = os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "..")
# Unpacked size of debian:trixie-slim on amd64, MB; the only layer that cannot be measured here.
BASE_MB = 79
LIMIT_MB = 120


def steps():
    """Instructions of the Dockerfile with their arguments, continued lines joined."""
    with open(os.path.join(ROOT, "docker", "Dockerfile")) as file:
        text = re.sub(r"\\\n\s*", "", file.read())
    lines = [line.strip() for line in text.splitlines() if line.strip() and not line.startswith("#")]
    return [tuple(line.split(None, 1)) for line in lines]


def main():
    args = arguments(__doc__)
    faults = Faults()
    work = tempfile.mkdtemp(prefix="wandless-image-")
    found = steps()
    stages = [i for i, (word, _) in enumerate(found) if word == "FROM"]
    build, final = found[:stages[1]], found[stages[1]:]
    for word, rest in build:
        if word == "COPY":
            *sources, target = rest.split()
            for source in sources:
                path = os.path.join(ROOT, source)
                faults.require(os.path.exists(path), f"{source} is copied but does not exist")
                place = os.path.join(work, "src", target if target != "./" else "", os.path.basename(source) if target == "./" else "")
                copy = shutil.copytree if os.path.isdir(path) else shutil.copy
                os.makedirs(os.path.dirname(place.rstrip("/")), exist_ok=True)
                copy(path, place.rstrip("/"), **({"ignore": shutil.ignore_patterns("node_modules", "dist")} if copy is shutil.copytree else {}))
    # Everything that the build reads at compile time must be copied.
    read = subprocess.run(["cargo", "metadata", "--offline", "--no-deps", "--format-version", "1"],
                          cwd=os.path.join(work, "src"), capture_output=True, text=True)
    faults.require(read.returncode == 0, f"the copied sources are not a package: {read.stderr[-300:]}")
    for folder, _, names in os.walk(os.path.join(work, "src", "src")):
        for name in names:
            with open(os.path.join(folder, name), errors="replace") as file:
                for quoted in re.findall(r"include_(?:str|bytes)!\(\"([^\"]+)\"\)", file.read()):
                    there = os.path.exists(os.path.normpath(os.path.join(folder, quoted)))
                    faults.require(there, f"{name} includes {quoted}, which the image does not copy")
    users = [rest for word, rest in final if word == "USER"]
    faults.require(users and not users[-1].startswith(("0", "root")), f"the image runs as {users}")
    faults.require(any(word == "HEALTHCHECK" for word, _ in final), "the health check is missing")
    volumes = [rest for word, rest in final if word == "VOLUME"]
    faults.require(volumes == ["/data"], f"volumes {volumes}")
    stripped = os.path.join(work, "wandless")
    shutil.copy(args.program, stripped)
    subprocess.run(["strip", stripped], check=True)
    size = os.path.getsize(stripped) / 1e6
    print(f"program {size:.1f} MB, image about {BASE_MB + size:.0f} MB")
    faults.require(BASE_MB + size <= LIMIT_MB, "the image is larger than 120 MB")
    linked = subprocess.run(["ldd", stripped], capture_output=True, text=True).stdout
    missing = [line.split()[0] for line in linked.splitlines()
                 if not re.search(r"linux-vdso|libc\.so|libm\.so|libgcc_s|ld-linux|libpthread|libdl", line)]
    faults.require(not missing, f"the base image lacks {missing}")
    shutil.rmtree(work)
    faults.end()


if __name__ == "__main__":
    main()
