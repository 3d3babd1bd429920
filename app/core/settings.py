"""Settings: typed, frozen, from TADA_* variables; read once by a composition root, never at import time.

The secrets among them have no defaults; tokens and codes are drawn per user and stored as hashes. A setting may also
stand in a file of the folder that TADA_SECRETS_DIR names, called as its variable (in small letters too): so secrets of
Docker, Kubernetes and systemd need not go through the environment. A variable goes before a file.
"""

import os
from functools import cached_property
from pathlib import Path
from typing import Literal
from urllib.parse import quote, urlsplit

from pydantic import Field, SecretStr
from pydantic_settings import BaseSettings, PydanticBaseSettingsSource, SecretsSettingsSource, SettingsConfigDict

MEBIBYTE = 1024 * 1024


class Settings(BaseSettings):
    """What the people who run the server may set. Every field is the variable TADA_<FIELD IN CAPITALS>."""

    model_config = SettingsConfigDict(env_prefix="TADA_", frozen=True, extra="ignore")

    data_dir: Path = Field(default=Path("data"), description="Where the embedded database and blob store live.")
    database_url: str | None = Field(default=None, description="SQLAlchemy URL; default: SQLite in data_dir.")
    database_password: SecretStr | None = Field(
        default=None, description="Of the user that the URL of the database names; default: what stands in the URL."
    )
    database_pool_size: int = Field(default=10, ge=1, description="Connections to the database that a process keeps.")
    database_pool_overflow: int = Field(default=10, ge=0, description="Connections more than that, for a while.")
    database_statement_seconds: float = Field(
        default=30.0, gt=0, description="PostgreSQL: one statement, at most; migrations have their own limit."
    )
    blob_url: str | None = Field(
        default=None, description="file:///path or s3://bucket/prefix; default: a folder in data_dir."
    )
    erasure_url: str | None = Field(
        default=None,
        description="The ledger of erasures, kept out of backups: file:///path or s3://bucket/prefix; default: a "
        "folder in data_dir, or where blobs are in S3, .erasures beside them.",
    )
    s3_endpoint: str | None = Field(default=None, description="http(s)://host:port of an S3 server that is not AWS.")
    s3_region: str = Field(default="us-east-1", min_length=1, description="The bucket's region.")
    s3_access_key_id: str | None = Field(
        default=None, description="With the secret key; neither: what AWS gives the machine or container."
    )
    s3_secret_access_key: SecretStr | None = Field(default=None, description="Goes with the access key's id.")
    secret_key: SecretStr | None = Field(
        default=None,
        min_length=32,
        description="Seals webhooks' secrets and names what was erased; on SQLite made by itself in data_dir.",
    )

    host: str = Field(default="127.0.0.1", description="Address that `tada serve` listens on.")
    port: int = Field(default=8000, ge=0, le=65535, description="Port that `tada serve` listens on; 0: any free one.")

    public_url: str | None = Field(
        default=None, description="Where phones reach the server, https://host; default: as the caller wrote it."
    )
    trusted_proxies: str | None = Field(
        default=None, description="Addresses or networks, comma between: only their X-Forwarded-For is believed."
    )

    webhook_allow_loopback: bool = Field(
        default=False, description="Webhooks may go to 127.0.0.1, also by plain http: for tests only."
    )

    max_photo_bytes: int = Field(default=30 * MEBIBYTE, ge=1, description="One photograph, at most.")
    max_photo_pixels: int = Field(default=60_000_000, ge=1, description="Width x height of one photograph, at most.")
    max_uploads: int = Field(default=16, ge=1, description="Uploads written at the same time in one process.")
    min_free_bytes: int = Field(default=512 * MEBIBYTE, ge=0, description="Below it uploads get storage_full.")

    estimate_seconds: float = Field(
        default=120.0, gt=0, description="Processor time of one estimate, at most; ten times that by the clock."
    )
    estimate_memory_bytes: int = Field(default=3072 * MEBIBYTE, gt=0, description="Address space of its process.")
    worker_concurrency: int | None = Field(
        default=None,
        ge=1,
        description="Estimates at the same time in one worker; default: as many as its cores and memory carry.",
    )
    export_days: int = Field(default=7, ge=1, description="How long a file made in the background is kept.")
    export_min_free_bytes: int = Field(
        default=1024 * MEBIBYTE, ge=0, description="Below it no file is made in the background; uploads go on."
    )
    api_children: int = Field(default=2, ge=1, description="Processes of one server that decode photographs at once.")
    enrolment_attempts_per_minute: int = Field(default=20, ge=1, description="Tries a minute and address, enrolment.")
    sign_in_attempts_per_minute: int = Field(
        default=10,
        ge=1,
        description="Passwords tried a minute of a name from an address; 3 times an address, 10 times a name.",
    )
    device_uploads_per_minute: int = Field(
        default=120, ge=0, description="Requests a minute and phone that send photographs or metadata; 0: no limit."
    )
    device_calls_per_minute: int = Field(default=600, ge=0, description="Other calls a minute and phone; 0: no limit.")
    staff_calls_per_minute: int = Field(default=1200, ge=0, description="Calls a minute and person; 0: no limit.")
    exports_per_minute: int = Field(
        default=30, ge=0, description="Files asked for a minute and phone or person; 0: no limit."
    )
    address_uploads_per_minute: int = Field(
        default=6000, ge=0, description="Uploads a minute and address; 0: no limit."
    )
    address_calls_per_minute: int = Field(
        default=12_000, ge=0, description="Other calls a minute and address; 0: no limit."
    )
    max_connections: int = Field(default=1000, ge=1, description="Open connections of one process.")
    max_connections_per_address: int = Field(
        default=500, ge=1, description="Connections, and requests at the same time, of one address in one process."
    )
    header_seconds: float = Field(default=10.0, gt=0, description="Within it a request's head must have come.")
    stall_seconds: float = Field(
        default=60.0, gt=0, description="Within it 16 KiB of a body must come, or of an answer be read."
    )
    stop_seconds: int = Field(
        default=20, ge=1, description="A server that is told to end lets requests under way go on for that long."
    )
    metrics_token: SecretStr | None = Field(
        default=None, min_length=16, description="Who sends it may read /metrics; unset: callers on the same machine."
    )
    metrics_host: str = Field(default="127.0.0.1", description="Address of a worker's metrics.")
    worker_metrics_port: int | None = Field(
        default=None, ge=0, le=65535, description="Port of a worker's /metrics and /healthz; unset: none, 0: any free."
    )
    log_level: Literal["DEBUG", "INFO", "WARNING", "ERROR"] = Field(default="INFO", description="Least level told.")
    log_format: Literal["json", "console"] = Field(default="json", description="json, or console for a person.")

    @classmethod
    def settings_customise_sources(
        cls,
        settings_cls: type[BaseSettings],
        init_settings: PydanticBaseSettingsSource,
        env_settings: PydanticBaseSettingsSource,
        dotenv_settings: PydanticBaseSettingsSource,
        file_secret_settings: PydanticBaseSettingsSource,
    ) -> tuple[PydanticBaseSettingsSource, ...]:
        """Arguments, then variables, then files of TADA_SECRETS_DIR. Raises NotADirectoryError for one that is none."""
        del dotenv_settings, file_secret_settings
        folder = os.environ.get("TADA_SECRETS_DIR")
        if not folder:
            return init_settings, env_settings
        if not Path(folder).is_dir():
            raise NotADirectoryError(f"TADA_SECRETS_DIR: {folder} is no folder.")
        return init_settings, env_settings, SecretsSettingsSource(settings_cls, secrets_dir=folder)

    @cached_property
    def resolved_database_url(self) -> str:
        """The database that is used: the given one, with its password, or SQLite in the data folder."""
        if self.database_url is None:
            return f"sqlite:///{self.data_dir.absolute() / 'tada.sqlite3'}"
        parts = urlsplit(self.database_url)
        if self.database_password is None or parts.username is None or parts.password is not None:
            return self.database_url
        user, _, host = parts.netloc.rpartition("@")
        password = quote(self.database_password.get_secret_value(), safe="")
        return parts._replace(netloc=f"{user}:{password}@{host}").geturl()

    @cached_property
    def resolved_blob_url(self) -> str:
        """The blob store that is used: the given one, or a folder in the data folder."""
        return self.blob_url or f"file://{self.data_dir.absolute() / 'blobs'}"

    @cached_property
    def resolved_erasure_url(self) -> str:
        """The ledger of erasures that is used: the given one, or a folder in the data folder.

        With blobs in S3 it stands beside them, where all machines see it and none takes it along when it goes.
        """
        if self.erasure_url is None and self.resolved_blob_url.startswith("s3://"):
            return f"{self.resolved_blob_url.rstrip('/')}/.erasures"
        return self.erasure_url or f"file://{self.data_dir.absolute() / 'erasures'}"

    @property
    def is_embedded(self) -> bool:
        """One machine: SQLite; a worker's life is then an OS file lock and `tada serve` runs its own worker."""
        return self.resolved_database_url.startswith("sqlite")
