"""`tada doctor`: report a deployment's problems in sentences; with `requeue`, queue stuck meals again.

A list of independent checks, each of one subject, so that a failed one hides only those that need
it.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import sqlalchemy.exc
import structlog

from app.core.errors import TadaError
from app.core.settings import Settings
from app.db.session import Database
from app.operations.doctor import doctor_data, doctor_settings, doctor_work
from app.operations.doctor.finding import Deployment, Finding, Verdict

__all__ = ["Finding", "examine"]

log = structlog.get_logger()


@dataclass(frozen=True, slots=True)
class Check:
    """look: returns None if there is nothing to report.

    needs: subjects whose checks must have passed.
    """

    subject: str
    look: Callable[[Deployment], Verdict | None]
    needs: frozenset[str] = frozenset()


DATABASE = frozenset({"schema"})
STORE = frozenset({"blob store"})
LEDGER = frozenset({"ledger of erasures"})
CHECKS = (
    Check("secret key", doctor_settings.look_at_secret_key),
    Check("private files", doctor_settings.look_at_private_files),
    Check("public url", doctor_settings.look_at_public_url),
    Check("way to the database", doctor_settings.look_at_way_to_database),
    Check("way to the store", doctor_settings.look_at_way_to_store),
    Check("proxies", doctor_settings.look_at_proxies),
    Check("webhooks' addresses", doctor_settings.look_at_webhook_addresses),
    Check("metrics", doctor_settings.look_at_metrics),
    Check("database", doctor_data.look_at_connection),
    Check("schema", doctor_data.look_at_schema, frozenset({"database"})),
    Check("secret key of the database", doctor_data.look_at_key_of_database, DATABASE),
    Check("blob store", doctor_data.look_at_store),
    Check("disk", doctor_data.look_at_disk, STORE),
    Check("blob store's versions", doctor_data.look_at_versions, STORE),
    Check("clock", doctor_data.look_at_clock, DATABASE),
    Check("postgresql", doctor_data.look_at_server_version, DATABASE),
    Check("durability", doctor_data.look_at_durability, DATABASE),
    Check("encoding", doctor_data.look_at_encoding, DATABASE),
    Check("connection", doctor_data.look_at_session_options, DATABASE),
    Check("connections", doctor_data.look_at_connections, DATABASE),
    Check("sqlite file", doctor_data.look_at_sqlite_file, DATABASE),
    Check("workers", doctor_work.look_at_workers, DATABASE),
    Check("queue", doctor_work.look_at_queue, DATABASE),
    Check("meals", doctor_work.look_at_stranded_meals, DATABASE),
    Check("failed meals", doctor_work.look_at_failures, DATABASE),
    Check("exports and releases", doctor_work.look_at_files, DATABASE),
    Check("releases that must change", doctor_work.look_at_stuck_releases, DATABASE),
    Check("photographs", doctor_data.look_at_photographs, DATABASE | STORE),
    Check("newest photographs", doctor_data.look_at_newest_photographs, DATABASE | STORE),
    Check("files of releases", doctor_data.look_at_release_files, DATABASE | STORE),
    Check("ledger of erasures", doctor_data.look_at_ledger, DATABASE),
    Check("ledger's entries", doctor_data.look_at_ledger_entries, LEDGER),
    Check("erasures", doctor_data.look_at_erasures, LEDGER),
    Check("webhooks' secrets", doctor_work.look_at_webhook_secrets, DATABASE),
    Check("webhooks", doctor_work.look_at_webhooks, DATABASE),
    Check("backup", doctor_work.look_at_backup, DATABASE),
    Check("index of foods", doctor_settings.look_at_food_index, DATABASE),
    Check("classifier", doctor_settings.look_at_classifier, DATABASE),
    Check("index", doctor_work.look_at_index, DATABASE),
)


def examine(database: Database, settings: Settings, *, requeue: bool) -> list[Finding]:
    """Run all checks.

    Changes nothing unless `requeue`; a part that does not answer is a finding too.
    """
    return list(_findings(Deployment(database, settings, requeue)))


def _findings(deployment: Deployment) -> Iterator[Finding]:
    passed = set[str]()
    for check in CHECKS:
        if not check.needs <= passed:
            continue
        try:
            verdict = check.look(deployment)
        except (sqlalchemy.exc.SQLAlchemyError, TadaError, OSError) as error:
            log.warning("doctor_could_not_ask", subject=check.subject, exc_info=error)
            verdict = (
                "bad",
                f"the check failed ({type(error).__name__}).",
                "See the log for details.",
            )
        if verdict is not None:
            finding = Finding(check.subject, *verdict)
            if finding.is_ok:
                passed.add(check.subject)
            yield finding
