"""What docker/compose.yaml says is what runs here: its processes and settings, from meals to their records."""

import contextlib
import csv
import io
import json
import pathlib
import secrets
import socket
import subprocess
import time
import uuid

import httpx2
import pytest
import sqlalchemy as sa

from app.db.session import normalise_url
from tests.conftest import postgres_database
from tests.e2e.composed import SCRIPTS, Composed, compose_config
from tests.e2e.processes import REPOSITORY, new_phone
from tests.support.s3_server import SERVICES, free_ports
from tests.support.waiting import wait_until

HOSTNAME = "tada.example.org"
SECONDS = 120
PAIR = REPOSITORY / "app" / "demo_data"
SECRETS = ("tada_secret_key", "tada_database_password", "tada_s3_secret_access_key", "tada_metrics_token")


def wait_for(what, *programs):
    def is_so():
        for program in programs:
            assert program.process.poll() is None, program.log
        return what()

    wait_until(is_so, lambda: "".join(program.log[-3000:] for program in programs), patience_seconds=SECONDS)


def send(phone, meal_id):
    metadata = {
        "id": meal_id,
        "captured_at": "2026-11-20T12:30:00+08:00",
        "time_zone": "Asia/Shanghai",
        "hints": [{"point": [1092, 620], "food": "apple"}],
    }
    files = {"metadata": ("m", json.dumps(metadata).encode(), "application/json")}
    files |= {slot: (slot, (PAIR / f"{slot}.jpg").read_bytes(), "image/jpeg") for slot in ("left", "right")}
    answer = phone.post("/v1/meals", files=files)
    assert answer.status_code == 202, answer.text


def estimated(phone, meal_id, deadline):
    """The meal when it waits no more."""
    while True:
        meal = phone.get(f"/v1/meals/{meal_id}", params={"wait": 20}).json()
        if meal["status"] not in ("queued", "processing"):
            return meal
        assert time.monotonic() < deadline, meal


def answers(url):
    try:
        return httpx2.get(url, timeout=5).status_code == 200
    except httpx2.TransportError:
        return False


def free_tcp_ports(count):
    with contextlib.ExitStack() as held:
        probes = [held.enter_context(socket.socket()) for _ in range(count)]
        for probe in probes:
            probe.bind(("127.0.0.1", 0))
        return [probe.getsockname()[1] for probe in probes]


@contextlib.contextmanager
def plain_role(server_url, password):
    """PostgreSQL for a user who is no superuser: the part of its URL behind the user's name."""
    admin = sa.create_engine(normalise_url(server_url), isolation_level="AUTOCOMMIT", poolclass=sa.NullPool)
    with postgres_database(server_url) as url, admin.connect() as connection:
        name = sa.make_url(url).database
        connection.execute(sa.text(f"CREATE ROLE tada LOGIN PASSWORD '{password}'"))
        connection.execute(sa.text(f"ALTER DATABASE {name} OWNER TO tada"))
        try:
            yield url
        finally:
            connection.execute(sa.text(f"ALTER DATABASE {name} OWNER TO CURRENT_USER"))
            other = sa.create_engine(url, isolation_level="AUTOCOMMIT", poolclass=sa.NullPool)
            with other.connect() as inside:
                inside.execute(sa.text("DROP OWNED BY tada"))
            connection.execute(sa.text("DROP ROLE tada"))
    admin.dispose()


def drawn_secrets(folder):
    """A file for each, as docker/make-secrets writes them. Returns the database's password."""
    folder.mkdir()
    for name in SECRETS:
        (folder / name).write_text(f"{secrets.token_hex(32)}\n")
    return (folder / "tada_database_password").read_text().strip()


def places(url, weed, folder):
    """Where here stands what the containers call by these names."""
    host = f"{url.host or ''}:{url.port}" if url.port else (url.host or "")
    query = "?" + "&".join(f"{key}={value}" for key, value in url.query.items()) if url.query else ""
    return {
        "tada@postgres:5432/tada": f"tada@{host}/{url.database}{query}",
        "http://s3:8333": f"http://127.0.0.1:{weed['s3']}",
        "s3:9333": f"127.0.0.1:{weed['master']}.{weed['master.grpc']}",
        "s3:8888": f"127.0.0.1:{weed['filer']}.{weed['filer.grpc']}",
        "-ip=s3": "-ip=127.0.0.1",
        "-ip.bind=0.0.0.0": "-ip.bind=127.0.0.1",
        "-dir=/data": f"-dir={folder / 's3'}",
        "8333": str(weed["s3"]),
        "/run/secrets": str(folder / "secrets"),
        "/etc/caddy": str(REPOSITORY / "docker"),
        "172.30.77.0/24": "127.0.0.1",
    }


def enrolled(composed, address, folder):
    """A phone's token."""
    made = subprocess.run(
        [*composed.command("migrate")[:3], "admin", "create", "chief"],
        env=composed.environment("api", TADA_DATA_DIR=str(folder / "command")),
        cwd=REPOSITORY,
        capture_output=True,
        text=True,
        check=True,
    )
    return new_phone(address, made.stdout.strip())


@pytest.mark.slow
def test_processes_and_settings_of_compose_take_meals_to_records(postgres_server, tmp_path):
    password = drawn_secrets(tmp_path / "secrets")
    config = compose_config(TADA_HOSTNAME=HOSTNAME)
    with contextlib.ExitStack() as cleanup:
        url = sa.make_url(cleanup.enter_context(plain_role(postgres_server, password)))
        weed = free_ports()
        proxy_port, health_port, *ports = free_tcp_ports(2 + 4)
        composed = Composed(config, tmp_path, places(url, weed, tmp_path))
        (tmp_path / "s3").mkdir()
        more = [f"-{name}.port={weed[name]}" for name in ("master", "volume", "filer")]
        more += [f"-{name}.port.grpc={weed[f'{name}.grpc']}" for name in SERVICES]
        more += [f"-{name}.localSocket={tmp_path / name}.sock" for name in ("filer", "s3")]
        s3 = composed.program("s3", more=more)
        for name in SERVICES:  # names that it takes in /tmp
            left = pathlib.Path(f"/tmp/seaweedfs-{name}-grpc-{weed[f'{name}.grpc']}.sock")
            cleanup.callback(left.unlink, missing_ok=True)
        cleanup.callback(s3.kill)  # SIGTERM would wait ten seconds for other servers to take note
        s3.start()
        wait_for(lambda: answers(f"http://127.0.0.1:{weed['s3']}/healthz"), s3)
        composed.run("buckets")
        composed.run("buckets")  # as at the next start: those that are there stay
        composed.run("migrate", TADA_DATA_DIR=str(tmp_path / "migrate"))

        apis, workers, checks = [], [], []
        for number, port in enumerate(ports[: composed.replicas("api")], 1):
            changes = {
                "TADA_DATA_DIR": str(tmp_path / f"api-{number}"),
                "TADA_HOST": "127.0.0.1",
                "TADA_PORT": str(port),
            }
            apis.append(composed.program("api", number, **changes))
            check = [word.replace(":8000/", f":{port}/") for word in composed.health_check("api")]
            checks.append((check, apis[-1], composed.environment("api")))
        for number, port in enumerate(ports[2:][: composed.replicas("worker")], 1):
            changes = {
                "TADA_DATA_DIR": str(tmp_path / f"worker-{number}"),
                "TADA_METRICS_HOST": "127.0.0.1",
                "TADA_WORKER_METRICS_PORT": str(port),
                "HEALTH_URL": composed.environment("worker")["HEALTH_URL"].replace("9100", str(port)),
            }
            workers.append(composed.program("worker", number, **changes))
            checks.append((composed.health_check("worker"), workers[-1], composed.environment("worker", **changes)))
        assert (len(apis), len(workers)) == (2, 2)
        proxy = composed.program(
            "proxy",
            TADA_SITE=f"http://127.0.0.1:{proxy_port}",
            TADA_UPSTREAMS="to " + " ".join(f"127.0.0.1:{port}" for port in ports[:2]),
            TADA_PROXY_HEALTH_PORT=str(health_port),
            XDG_DATA_HOME=str(tmp_path / "caddy"),
            XDG_CONFIG_HOME=str(tmp_path / "caddy"),
        )
        for program in (*apis, *workers, proxy):
            cleanup.callback(program.stop)
            program.start()
        for command, program, environment in checks:
            wait_for(
                lambda c=command, e=environment: (
                    subprocess.run(c, env=e, capture_output=True, check=False).returncode == 0
                ),
                program,
            )
        address = f"http://127.0.0.1:{proxy_port}"
        wait_for(lambda: answers(f"{address}/readyz"), proxy)

        token = enrolled(composed, address, tmp_path)
        deadline = time.monotonic() + SECONDS
        meals = []
        for way in (address, f"http://127.0.0.1:{ports[0]}"):
            phone = httpx2.Client(base_url=way, headers={"Authorization": f"Bearer {token}"}, timeout=30)
            cleanup.enter_context(phone)
            meals.append(str(uuid.uuid4()))
            send(phone, meals[-1])
        with httpx2.Client(base_url=address, headers=phone.headers, timeout=30) as client:  # whichever API it asks
            assert {estimated(client, meal_id, deadline)["status"] for meal_id in meals} == {"estimated"}
        records = list(csv.DictReader(io.StringIO(phone.get("/v1/records", params={"format": "csv"}).text)))
        assert sorted(record["meal_id"] for record in records) == sorted(meals)
        assert httpx2.get(f"{address}/metrics", timeout=5).status_code == 404
        assert not [line for program in (*apis, *workers) for line in program.log.splitlines() if '"error"' in line]


def test_proxy_file_is_valid_and_formatted(tmp_path):
    path = REPOSITORY / "docker" / "Caddyfile"
    proxy = compose_config(TADA_HOSTNAME=HOSTNAME)["services"]["proxy"]
    done = subprocess.run(
        [SCRIPTS / "caddy", "validate", "--config", path, "--adapter", "caddyfile"],
        env={"XDG_DATA_HOME": str(tmp_path), "XDG_CONFIG_HOME": str(tmp_path)} | proxy["environment"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert (
        subprocess.run([SCRIPTS / "caddy", "fmt", path], capture_output=True, text=True, check=True).stdout
        == path.read_text()
    )
