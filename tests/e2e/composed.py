"""What docker/compose.yaml says, as processes of this machine: the same commands and variables, without containers.

Names and ports of containers become ports of 127.0.0.1, volumes and secrets become folders of the test; nothing else is
changed. The image's own part (entrypoint, variables, health check) is read from docker/Dockerfile.
"""

import json
import os
import pathlib
import re
import shlex
import subprocess
import sys
import sysconfig

from tests.e2e.processes import REPOSITORY, Program

COMPOSE = REPOSITORY / "docker" / "compose.yaml"
SCRIPTS = pathlib.Path(sysconfig.get_path("scripts"))


def compose_config(**variables):
    """compose.yaml as Compose itself reads it, with nothing set but these variables."""
    done = subprocess.run(
        [SCRIPTS / "docker-compose", "--env-file", os.devnull, "-f", COMPOSE, "config", "--format", "json"],
        env={"PATH": os.environ["PATH"], "HOME": os.environ.get("HOME", "/")} | variables,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.replace("$$", "$"))


def image_environment():
    """ENV of the image's last stage, without PATH."""
    last = dockerfile().rpartition("\nFROM ")[2]
    told = " ".join(re.findall(r"^ENV (.+)$", last, re.MULTILINE))
    variables = dict(word.split("=", 1) for word in shlex.split(told))
    del variables["PATH"]
    return variables


def image_health_check():
    return json.loads(re.search(r"^HEALTHCHECK .* CMD (\[.+\])$", dockerfile(), re.MULTILINE)[1])


def image_entrypoint():
    return json.loads(re.search(r"^ENTRYPOINT (\[.+\])$", dockerfile(), re.MULTILINE)[1])


def dockerfile():
    """Its instructions, one a line."""
    return (REPOSITORY / "docker" / "Dockerfile").read_text().replace("\\\n", " ")


class Composed:
    """replaced: what stands in for names, ports and paths of containers, the longest first."""

    def __init__(self, config, folder, replaced):
        self._config, self._folder = config, folder
        self._replaced = sorted(replaced.items(), key=lambda pair: -len(pair[0]))

    def replicas(self, service):
        return self._config["services"][service].get("deploy", {}).get("replicas", 1)

    def here(self, text):
        for theirs, ours in self._replaced:
            text = text.replace(theirs, ours)
        return text

    def environment(self, service, **changes):
        """changes: what differs between two replicas that share this machine."""
        told = {name: self.here(str(value)) for name, value in self._config["services"][service]["environment"].items()}
        rest = {name: value for name, value in os.environ.items() if not name.startswith("TADA_")}
        path = f"{SCRIPTS}{os.pathsep}{rest['PATH']}"
        image = image_environment() if self._is_ours(service) else {}
        return rest | image | told | {"PATH": path} | changes

    def command(self, service, *more):
        said = self._config["services"][service]
        if self._is_ours(service):
            assert image_entrypoint() == ["tini", "--", "tada"]
            begin = [sys.executable, "-m", "app.cli"]
        else:
            begin = said.get("entrypoint") or []
        return [self.here(word) for word in [*begin, *(said.get("command") or [])]] + list(more)

    def health_check(self, service):
        test = self._config["services"][service].get("healthcheck", {}).get("test")
        return [self.here(word) for word in test[1:]] if test else image_health_check()

    def program(self, service, number=1, more=(), **changes):
        log_path = self._folder / f"{service}-{number}.log"
        return Program(self.command(service, *more), self.environment(service, **changes), log_path)

    def run(self, service, **changes):
        """One that ends: what it printed. It must end well."""
        done = subprocess.run(
            self.command(service),
            env=self.environment(service, **changes),
            cwd=REPOSITORY,
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    def _is_ours(self, service):
        return "build" in self._config["services"][service]
