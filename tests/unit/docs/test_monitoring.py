"""Dashboard, alert rules and their page: they name only what /metrics tells, and the page tells all of it."""

import inspect
import json
import pathlib
from collections import Counter
from datetime import UTC, datetime

import promql_parser
import pytest
import yaml
from prometheus_client.metrics import MetricWrapperBase

from app.core.settings import Settings
from app.db.session import Database
from app.metrics import instruments
from app.operations.doctor import doctor_work
from app.operations.figures import Deployment, DeploymentFigures
from app.operations.queries import Figures, FilesWaiting, LastBackup
from app.storage.local import LocalBlobStore

ROOT = pathlib.Path(__file__).parents[3]
ALERTS = [
    rule
    for group in yaml.safe_load((ROOT / "docker" / "prometheus" / "alerts.yml").read_text())["groups"]
    for rule in group["rules"]
]
DASHBOARD = json.loads((ROOT / "docker" / "grafana" / "tada.json").read_text())
PANELS = [panel for panel in DASHBOARD["panels"] if panel["type"] != "row"]
TARGET_LABELS = {"job", "instance"}  # Prometheus' own, of every target
SUFFIXES = {
    "counter": {"_total": set()},
    "gauge": {"": set()},
    "histogram": {"_bucket": {"le"}, "_sum": set(), "_count": set()},
}


@pytest.fixture(scope="module")
def families(tmp_path_factory):
    """(name, type, labels) of everything that /metrics of a server and of a worker can tell."""
    own = [one for _, one in inspect.getmembers(instruments) if isinstance(one, MetricWrapperBase)]
    found = [(family.name, family.type, one._labelnames) for one in own for family in one.describe()]
    folder = tmp_path_factory.mktemp("figures")
    database = Database(f"sqlite:///{folder / 'none.sqlite3'}")
    asked = DeploymentFigures(database, LocalBlobStore(folder / "blobs"), Settings(data_dir=folder))
    now = datetime.now(UTC)
    asked._fetch = lambda: Deployment(
        Figures(
            now,
            {"queued": 1},
            {"queued": 1},
            now,
            1,
            1,
            now,
            1,
            1,
            now,
            {"export": FilesWaiting({"queued": 1}, now)},
            1,
        ),
        Counter({"1": 1}),
        LastBackup(now, damaged=1),
        now,
    )
    found += [(family.name, family.type, family._labelnames) for family in asked.collect()]
    database.dispose()
    return {(name, kind): set(labels) for name, kind, labels in found}


@pytest.fixture(scope="module")
def series(families):
    """Name of a series -> its labels."""
    found = {
        name + suffix: labels | more
        for (name, kind), labels in families.items()
        for suffix, more in SUFFIXES[kind].items()
    }
    process = {family.name: family for family in instruments.REGISTRY.collect() if family.name.startswith("process_")}
    assert process  # on Linux
    return found | {sample.name: set() for family in process.values() for sample in family.samples}


def nodes_of(expression):
    found = []
    promql_parser.walk(promql_parser.parse(expression), found.append)
    return found


def faults_of(expression, series):
    """Series and labels of a PromQL expression that nobody tells."""
    nodes = nodes_of(expression)
    selectors = [node for node in nodes if isinstance(node, promql_parser.VectorSelector)]
    faults = [selector.name for selector in selectors if selector.name not in series]
    known = set().union(TARGET_LABELS, *(series.get(selector.name, set()) for selector in selectors))
    for selector in selectors:
        own = series.get(selector.name, set()) | TARGET_LABELS
        faults += [f"{selector.name}{{{one.name}}}" for one in selector.matchers.matchers if one.name not in own]
    for node in nodes:
        if isinstance(node, promql_parser.AggregateExpr) and node.modifier is not None:
            faults += [f"by ({label})" for label in node.modifier.labels if label not in known]
    assert selectors or "absent" in expression
    return faults


EXPRESSIONS = [("alert " + rule["alert"], rule["expr"]) for rule in ALERTS] + [
    ("panel " + panel["title"], target["expr"]) for panel in PANELS for target in panel["targets"]
]


def test_expressions_name_only_series_and_labels_that_are_told(series):
    faults = {place: faults_of(expression, series) for place, expression in EXPRESSIONS}
    assert {place: found for place, found in faults.items() if found} == {}


def test_alerts_know_the_servers_failures_and_the_age_of_a_backup():
    expressions = {rule["alert"]: rule["expr"] for rule in ALERTS}
    listed = "|".join(instruments.SERVER_FAILURES)
    assert f'"{listed}"' in expressions["TadaEstimatesFail"]
    assert f'"ok|cancelled|{listed}"' in expressions["TadaPhotographsUnfit"]
    assert f'"{"|".join(instruments.REFUSALS)}"' in expressions["TadaUploadsRefused"]
    limit = int(doctor_work.BACKUP_EVERY.total_seconds())
    assert expressions["TadaBackupOld"].endswith(f"> {limit}")


def test_series_begin_at_zero_where_an_alert_counts_their_increase():
    instruments.register_build("api")
    instruments.register_build("worker")
    told = {
        (sample.name, tuple(sorted(sample.labels.items())))
        for family in instruments.REGISTRY.collect()
        for sample in family.samples
    }
    for code in instruments.SERVER_FAILURES:
        assert ("tada_estimates_total", (("outcome", code), ("purpose", "meal"))) in told
    assert ("tada_swept_total", (("what", "queued"),)) in told
    assert ("tada_uploads_total", (("outcome", "storage_full"),)) in told


def test_prometheus_reads_the_rules_and_asks_servers_and_workers_of_compose_with_the_token():
    asked = yaml.safe_load((ROOT / "docker" / "prometheus" / "prometheus.yml").read_text())
    compose = yaml.safe_load((ROOT / "docker" / "compose.yaml").read_text())
    assert [(ROOT / "docker" / "prometheus" / name).is_file() for name in asked["rule_files"]] == [True]
    targets = {}
    for job in asked["scrape_configs"]:
        (found,) = job["dns_sd_configs"]
        (service,) = found["names"]
        targets[job["job_name"]] = (service, found["port"])
        secret = pathlib.PurePath(job["authorization"]["credentials_file"]).name
        assert secret in compose["services"]["prometheus"]["secrets"]
        assert secret in compose["services"][service]["secrets"]
    assert targets["tada-api"][0] == "api"
    worker = compose["services"]["worker"]["environment"]
    assert targets["tada-worker"] == ("worker", worker["TADA_WORKER_METRICS_PORT"])
    assert worker["TADA_METRICS_HOST"] == "0.0.0.0"
