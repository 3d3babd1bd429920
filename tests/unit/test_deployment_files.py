"""Files that deploy the program: they parse, pass their tools, and name what there is."""

import os
import pathlib
import re
import shutil
import stat
import subprocess
import sys
import sysconfig
import tomllib

import pytest
import yaml

from app.core.settings import Settings
from app.main import create_app
from app.metrics import instruments

ROOT = pathlib.Path(__file__).parents[2]
SCRIPTS = pathlib.Path(sysconfig.get_path("scripts"))
KNOWN = {f"TADA_{name.upper()}" for name in Settings.model_fields} | {"TADA_SECRETS_DIR"}
OF_COMPOSE = re.compile(
    r"^TADA_(HOSTNAME|VERSION|LOCAL_PORT|FRONT_SUBNET|SITE|UPSTREAMS|PROXY_HEALTH_PORT|\w+_(REPLICAS|MEMORY))$"
)
SMALL_MACHINE_BYTES = 4 * 10**9
OF_POSTGRES = {"TADA_POSTGRES_CONNECTIONS", "TADA_POSTGRES_BUFFERS"}


def compose(file="compose.yaml", **variables):
    command = [SCRIPTS / "docker-compose", "--env-file", os.devnull, "-f", ROOT / "docker" / file]
    environment = {"PATH": os.environ["PATH"], "HOME": os.environ.get("HOME", "/")} | variables
    return subprocess.run(
        [*command, "--profile", "*", "config"], env=environment, capture_output=True, text=True, check=False
    )


@pytest.fixture(scope="module")
def services():
    done = compose(TADA_HOSTNAME="tada.example.org")
    assert done.returncode == 0, done.stderr
    return yaml.safe_load(done.stdout)["services"]


def test_image_has_all_that_the_wheel_is_built_of_and_those_of_others_are_pinned_by_digest(services):
    wheel = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["hatch"]["build"]["targets"]["wheel"]
    copied = re.findall(r"^COPY (\S+) \./", (ROOT / "docker" / "Dockerfile").read_text(), re.MULTILINE)
    sent = re.findall(r"^!(\S+)", (ROOT / ".dockerignore").read_text(), re.MULTILINE)
    for source in (*wheel["packages"], *wheel["force-include"]):
        assert source in copied
        assert source in sent
    begin = re.findall(r"^FROM (\S+)", (ROOT / "docker" / "Dockerfile").read_text(), re.MULTILINE)
    images = {*begin, *(service["image"] for service in services.values())}
    others = {image for image in images if not image.startswith("tada-server:")}
    assert len(others) > 4
    assert {image for image in others if not re.fullmatch(r"\S+:[\w.-]+@sha256:[0-9a-f]{64}", image)} == set()


def test_dockerfile_passes_hadolint():
    done = subprocess.run(
        [SCRIPTS / "hadolint", ROOT / "docker" / "Dockerfile"], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout


def test_compose_does_not_begin_without_the_servers_name():
    done = compose()
    assert done.returncode != 0
    assert "TADA_HOSTNAME" in done.stderr


def test_services_of_compose_have_limits_no_secrets_no_needless_rights_and_only_the_proxy_is_reached_from_outside(
    services,
):
    open_to_all = {
        name
        for name, service in services.items()
        for port in service.get("ports", ())
        if port.get("host_ip") != "127.0.0.1"
    }
    assert open_to_all == {"proxy"}
    for name, service in services.items():
        assert re.search(r":v?[\w.-]*\d+\.\d+|tada-server:", service["image"]), name
        assert service["restart"] in ("unless-stopped", "no", "on-failure:5"), name
        if service["restart"] == "unless-stopped":
            assert int(service["deploy"]["resources"]["limits"]["memory"]) > 0, name
    worker = services["worker"]
    assert worker["deploy"]["replicas"] > 1
    assert int(worker["environment"]["TADA_WORKER_CONCURRENCY"]) >= 1
    for name, service in services.items():
        for variable, value in (service.get("environment") or {}).items():
            is_secret = re.search(r"PASSWORD|SECRET|TOKEN", variable) and not variable.endswith(("_FILE", "_DIR"))
            assert not is_secret, (name, variable, value)
    kept = {name: set(service.get("cap_add", ())) for name, service in services.items()}
    needed = {"proxy": {"NET_BIND_SERVICE"}, "s3": {"DAC_OVERRIDE"}}
    assert kept == {name: needed.get(name, set()) for name in services}
    for name, service in services.items():
        assert service["read_only"] is True, name
        assert service["cap_drop"] == ["ALL"], name
        assert service["security_opt"] == ["no-new-privileges:true"], name


def test_local_compose_file_needs_no_domain_and_is_reached_from_its_own_machine_only():
    done = compose("compose.local.yaml")
    assert done.returncode == 0, done.stderr
    (service,) = yaml.safe_load(done.stdout)["services"].values()
    assert service["command"] == ["serve"]
    assert [(port["host_ip"], port["target"]) for port in service["ports"]] == [("127.0.0.1", 8000)]
    assert int(service["deploy"]["resources"]["limits"]["memory"]) < SMALL_MACHINE_BYTES
    assert service["read_only"] is True
    assert service["cap_drop"] == ["ALL"]
    assert service["security_opt"] == ["no-new-privileges:true"]


def test_every_variable_of_compose_and_its_example_is_known():
    for name in ("compose.yaml", "compose.local.yaml", ".env.example", "Caddyfile", "Dockerfile", "systemd/tada.env"):
        told = set(re.findall(r"\bTADA_[A-Z0-9_]+", (ROOT / "docker" / name).read_text()))
        assert {one for one in told if one not in KNOWN | OF_POSTGRES and not OF_COMPOSE.match(one)} == set(), name


def test_secrets_that_compose_reads_are_drawn_once_and_kept(tmp_path):
    script = tmp_path / "make-secrets"
    script.write_bytes((ROOT / "docker" / "make-secrets").read_bytes())
    subprocess.run(["sh", script], check=True, capture_output=True)
    files = {path.name: path.read_text() for path in (tmp_path / "secrets").iterdir()}
    named = yaml.safe_load((ROOT / "docker" / "compose.yaml").read_text())["secrets"]
    assert set(files) == set(named)
    assert {len(text) for text in files.values()} == {64}
    assert len(set(files.values())) == len(files)
    assert stat.S_IMODE((tmp_path / "secrets").stat().st_mode) == 0o700
    subprocess.run(["sh", script], check=True, capture_output=True)
    assert {path.name: path.read_text() for path in (tmp_path / "secrets").iterdir()} == files


def kubernetes():
    files = sorted((ROOT / "docker" / "kubernetes").rglob("*.yaml"))
    return [document for path in files for document in yaml.safe_load_all(path.read_text())]


def pods():
    return {
        one["metadata"]["name"]: one["spec"]["template"]["spec"]
        for one in kubernetes()
        if one["kind"] in ("Deployment", "Job")
    }


def test_kubernetes_files_have_settings_and_metrics_that_there_are_and_pods_run_as_nobody():
    documents = kubernetes()
    assert {one["kind"] for one in documents} >= {"Deployment", "Job", "PodDisruptionBudget", "Service", "Ingress"}
    told = {name for one in documents if one["kind"] == "ConfigMap" for name in one["data"]}
    for pod in pods().values():
        for container in pod["containers"]:
            told |= {variable["name"] for variable in container.get("env", ())}
    assert told - KNOWN == set()
    Settings(**{name.removeprefix("TADA_").lower(): "1" for name in told if "METRICS_PORT" in name})
    for name, pod in pods().items():
        assert pod["securityContext"]["runAsNonRoot"] is True, name
        assert pod["securityContext"]["seccompProfile"] == {"type": "RuntimeDefault"}, name
        assert pod.get("terminationGracePeriodSeconds", 30) >= 15, name
        mounted = {volume["name"] for volume in pod["volumes"]}
        for container in pod["containers"]:
            rights = container["securityContext"]
            assert rights["readOnlyRootFilesystem"] is True
            assert rights["allowPrivilegeEscalation"] is False
            assert rights["capabilities"] == {"drop": ["ALL"]}
            assert {mount["name"] for mount in container["volumeMounts"]} == mounted
            assert "memory" in container["resources"]["limits"]
    scaled = next(one for one in kubernetes() if one["kind"] == "ScaledObject")
    query = scaled["spec"]["triggers"][0]["metadata"]["query"]
    names = re.findall(r"tada_\w+", query)
    source = "".join(path.read_text() for path in pathlib.Path(instruments.__file__).parents[1].rglob("*.py"))
    assert names
    assert all(name in source for name in names)


def test_kubernetes_passes_on_every_route_but_metrics():
    ingress = next(one for one in kubernetes() if one["kind"] == "Ingress")
    passed = [(path["path"], path["pathType"]) for path in ingress["spec"]["rules"][0]["http"]["paths"]]

    def is_passed(route):
        return any(route == path or (kind == "Prefix" and route.startswith(f"{path}/")) for path, kind in passed)

    routes = {path for _, path in create_app(Settings()).state.rules} | {
        "/docs",
        "/docs/guide/x",
        "/openapi.json",
        "/dashboard/static/x.css",
        "/capture/x.js",
    }
    assert {route for route in routes if not is_passed(route)} == {"/metrics"}


def test_children_of_an_api_pod_cannot_outgrow_it():
    (container,) = pods()["tada-api"]["containers"]
    values = {each["name"]: int(each["value"]) for each in container["env"]}
    assert container["resources"]["limits"]["memory"] == "1Gi"
    assert values["TADA_API_CHILDREN"] * values["TADA_ESTIMATE_MEMORY_BYTES"] <= 2**30


def test_pods_of_kubernetes_fit_a_machine_of_four_gigabytes():
    mebibytes = 0
    for one in kubernetes():
        if one["kind"] == "Deployment":
            (container,) = one["spec"]["template"]["spec"]["containers"]
            limit = {"Gi": 1024, "Mi": 1}[container["resources"]["limits"]["memory"][-2:]]
            mebibytes += one["spec"]["replicas"] * limit * int(container["resources"]["limits"]["memory"][:-2])
    assert mebibytes * 2**20 < SMALL_MACHINE_BYTES


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="without systemd")
def test_unit_of_systemd_is_valid(tmp_path):
    unit = (ROOT / "docker" / "systemd" / "tada.service").read_text()
    path = tmp_path / "tada.service"
    path.write_text(unit.replace("/opt/tada/bin/tada", sys.executable))
    done = subprocess.run(["systemd-analyze", "verify", path], capture_output=True, text=True, check=False)
    assert "tada.service" not in done.stderr, done.stderr
