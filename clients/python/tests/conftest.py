"""A service under test, and a simulated session."""

import os
import pathlib
import subprocess

import pytest

ROOT = pathlib.Path(__file__).resolve().parents[3]
PROGRAM = os.environ.get("WANDLESS_PROGRAM", str(ROOT / "target" / "release" / "wandless"))


@pytest.fixture(scope="session")
def server(tmp_path_factory):
    """URL of a service that may call webhooks on this machine."""
    command = [PROGRAM, "serve", "--listen", "127.0.0.1:0", "--data", str(tmp_path_factory.mktemp("data"))]
    command += ["--set", 'webhooks.allowed_networks=["127.0.0.0/8"]']
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as service:
        yield service.stdout.readline().split()[-1]
        service.terminate()


@pytest.fixture(scope="session")
def take(tmp_path_factory):
    """Folder of a simulated session: two people, three cameras, 40 frames."""
    folder = tmp_path_factory.mktemp("take") / "take"
    words = "simulate --people 2 --views 3 --frames 40 --seed 3 --out".split()
    subprocess.run([PROGRAM, *words, str(folder)], check=True, stdout=subprocess.DEVNULL)
    return folder
