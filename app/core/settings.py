"""Settings: typed, frozen, from TADA_* variables; read once by a composition root, never at import time.

Secrets have no defaults; tokens and codes are drawn per user and stored as hashes. A setting may
also be in a file of the folder TADA_SECRETS_DIR, named like its variable (or in lower case), so
that secrets of Docker, Kubernetes and systemd need not be in the environment. A variable takes
precedence over a file.
"""

import os
from functools import cached_property
from pathlib import Path
from typing import Literal, Self
from urllib.parse import quote, urlsplit

from pydantic import Field, SecretStr, model_validator
from pydantic_settings import (
    BaseSettings,
    PydanticBaseSettingsSource,
    SecretsSettingsSource,
    SettingsConfigDict,
)

MEBIBYTE = 1024 * 1024


class Settings(BaseSettings):
    """Settings of the operators. Every field is the variable TADA_<FIELD IN CAPITALS>."""

    model_config = SettingsConfigDict(env_prefix="TADA_", frozen=True, extra="ignore")

    data_dir: Path = Field(
        default=Path("data"), description="Folder of the embedded database and blob store."
    )
    database_url: str | None = Field(
        default=None, description="SQLAlchemy URL; default: SQLite in data_dir."
    )
    database_password: SecretStr | None = Field(
        default=None,
        description="Password of the database URL's user; default: the one in the URL.",
    )
    database_pool_size: int = Field(
        default=10, ge=1, description="Connections to the database that a process keeps open."
    )
    database_pool_overflow: int = Field(
        default=10, ge=0, description="Additional connections while a process is busy."
    )
    database_statement_seconds: float = Field(
        default=30.0,
        gt=0,
        description="PostgreSQL: maximum time of a statement; migrations have their own limit.",
    )
    blob_url: str | None = Field(
        default=None,
        description="file:///path or s3://bucket/prefix; default: a folder in data_dir.",
    )
    erasure_url: str | None = Field(
        default=None,
        description="The ledger of erasures, kept out of backups: file:///path or s3://bucket/prefix; default: a "
        "folder in data_dir; with blobs in S3, .erasures beside them.",
    )
    s3_endpoint: str | None = Field(
        default=None, description="http(s)://host:port of an S3 server other than AWS."
    )
    s3_region: str = Field(default="us-east-1", min_length=1, description="The bucket's region.")
    s3_access_key_id: str | None = Field(
        default=None,
        description="Set together with the secret key; neither: AWS's credentials of the machine or container.",
    )
    s3_secret_access_key: SecretStr | None = Field(
        default=None, description="Belongs to the access key's id."
    )
    secret_key: SecretStr | None = Field(
        default=None,
        min_length=32,
        description="Seals secrets of webhooks and codes, keys the erasures' ledger; "
        "on SQLite generated in data_dir.",
    )

    host: str = Field(default="127.0.0.1", description="Address that `tada serve` listens on.")
    port: int = Field(
        default=8000,
        ge=0,
        le=65535,
        description="Port that `tada serve` listens on; 0: any free one.",
    )

    public_url: str | None = Field(
        default=None,
        description="Address of the server for phones, https://host; default: the one that the caller used.",
    )
    trusted_proxies: str | None = Field(
        default=None,
        description="Addresses or networks, separated by commas, whose X-Forwarded-For is trusted.",
    )

    web_origins: str | None = Field(
        default=None,
        description="Origins of others' web apps that may call the API, separated by commas, such as "
        "https://app.example.org; unset: those of studies alone.",
    )

    oidc_issuer: str | None = Field(
        default=None,
        pattern=r"^(https://|http://(localhost|127\.0\.0\.1)(:\d+)?(/|$))\S*$",
        description="Provider by whose accounts staff may sign in, too (OpenID Connect), such as "
        "https://login.example.org.",
    )
    oidc_client_id: str | None = Field(default=None, description="The server's name there.")
    oidc_client_secret: SecretStr | None = Field(
        default=None, description="The server's secret there."
    )

    push_contact: str | None = Field(
        default=None,
        pattern=r"^(mailto:[^@\s]+@[^@\s]+|https://\S+)$",
        description="Turns reminders by Web Push on: mailto: or https: address at which push services reach you.",
    )
    webhook_allow_loopback: bool = Field(
        default=False,
        description="Allow webhooks to 127.0.0.1, also by plain http: for tests only.",
    )

    max_photo_bytes: int = Field(
        default=30 * MEBIBYTE, ge=1, description="Maximum size of a photograph."
    )
    max_photo_pixels: int = Field(
        default=60_000_000, ge=1, description="Maximum width x height of a photograph."
    )
    max_uploads: int = Field(
        default=16, ge=1, description="Uploads written simultaneously in one process."
    )
    min_free_bytes: int = Field(
        default=512 * MEBIBYTE, ge=0, description="With less free space, uploads get storage_full."
    )

    estimate_seconds: float = Field(
        default=120.0,
        gt=0,
        description="Maximum processor time of an estimate; ten times that by the clock.",
    )
    estimate_memory_bytes: int = Field(
        default=3072 * MEBIBYTE, gt=0, description="Maximum address space of an estimate's process."
    )
    worker_concurrency: int | None = Field(
        default=None,
        ge=1,
        description="Simultaneous estimates in one worker; default: by its cores and memory.",
    )
    food_index: Path | None = Field(
        default=None,
        description="Index of how foods look, made by `tada index build`; default: the shipped one.",
    )
    classifier: Path | None = Field(
        default=None,
        description="Description (TOML) of an ONNX network whose candidates join the index's; default: none.",
    )
    export_days: int = Field(
        default=7, ge=1, description="Days that a file made in the background is kept."
    )
    export_min_free_bytes: int = Field(
        default=1024 * MEBIBYTE,
        ge=0,
        description="With less free space, no file is made in the background; uploads continue.",
    )
    api_children: int = Field(
        default=2, ge=1, description="Child processes of one server that decode photographs."
    )
    enrolment_attempts_per_minute: int = Field(
        default=20, ge=1, description="Enrolment attempts per minute and address."
    )
    sign_in_attempts_per_minute: int = Field(
        default=10,
        ge=1,
        description="Password attempts per minute for a name from an address; 3 times per address, 10 times per name.",
    )
    device_uploads_per_minute: int = Field(
        default=120,
        ge=0,
        description="Requests per minute and phone with photographs or metadata; 0: no limit.",
    )
    device_calls_per_minute: int = Field(
        default=600, ge=0, description="Other calls per minute and phone; 0: no limit."
    )
    staff_calls_per_minute: int = Field(
        default=1200, ge=0, description="Calls per minute and person; 0: no limit."
    )
    exports_per_minute: int = Field(
        default=30, ge=0, description="Files requested per minute and phone or person; 0: no limit."
    )
    address_uploads_per_minute: int = Field(
        default=6000, ge=0, description="Uploads per minute and address; 0: no limit."
    )
    address_calls_per_minute: int = Field(
        default=12_000, ge=0, description="Other calls per minute and address; 0: no limit."
    )
    max_connections: int = Field(default=1000, ge=1, description="Open connections of one process.")
    max_connections_per_address: int = Field(
        default=500, ge=1, description="Simultaneous requests of one address to one process."
    )
    stall_seconds: float = Field(
        default=60.0, gt=0, description="Maximum time for 16 KiB of a request's body to arrive."
    )
    stop_seconds: int = Field(
        default=20,
        ge=1,
        description="Time that requests in progress get when the server shuts down.",
    )
    metrics_token: SecretStr | None = Field(
        default=None,
        min_length=16,
        description="Bearer token for /metrics; unset: only callers on the same machine.",
    )
    metrics_host: str = Field(
        default="127.0.0.1", description="Address that a worker's metrics listen on."
    )
    worker_metrics_port: int | None = Field(
        default=None,
        ge=0,
        le=65535,
        description="Port of a worker's /metrics and /healthz; unset: none, 0: any free.",
    )
    log_level: Literal["DEBUG", "INFO", "WARNING", "ERROR"] = Field(
        default="INFO", description="Lowest level that is logged."
    )
    log_format: Literal["json", "console"] = Field(
        default="json", description="json, or console for reading."
    )

    @classmethod
    def settings_customise_sources(
        cls,
        settings_cls: type[BaseSettings],
        init_settings: PydanticBaseSettingsSource,
        env_settings: PydanticBaseSettingsSource,
        dotenv_settings: PydanticBaseSettingsSource,
        file_secret_settings: PydanticBaseSettingsSource,
    ) -> tuple[PydanticBaseSettingsSource, ...]:
        """Order the sources: arguments, variables, files of TADA_SECRETS_DIR.

        Raises NotADirectoryError.
        """
        del dotenv_settings, file_secret_settings
        folder = os.environ.get("TADA_SECRETS_DIR")
        if not folder:
            return init_settings, env_settings
        if not Path(folder).is_dir():
            raise NotADirectoryError(f"TADA_SECRETS_DIR: {folder} is not a folder.")
        return init_settings, env_settings, SecretsSettingsSource(settings_cls, secrets_dir=folder)

    @model_validator(mode="after")
    def _require_whole_provider(self) -> Self:
        values = self.oidc_issuer, self.oidc_client_id, self.oidc_client_secret
        if any(values) and not all(values):
            raise ValueError("Set all of TADA_OIDC_ISSUER, _CLIENT_ID and _CLIENT_SECRET, or none.")
        return self

    @cached_property
    def resolved_database_url(self) -> str:
        """Return the database's URL: the configured one, with its password, or SQLite in the data folder."""
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
        """Return the blob store's URL: the configured one, or a folder in the data folder."""
        return self.blob_url or f"file://{self.data_dir.absolute() / 'blobs'}"

    @cached_property
    def resolved_erasure_url(self) -> str:
        """Return the URL of the ledger of erasures: the configured one, or a folder in the data folder.

        With blobs in S3 it is beside them, where all machines see it and the loss of a machine does
        not affect it.
        """
        if self.erasure_url is None and self.resolved_blob_url.startswith("s3://"):
            return f"{self.resolved_blob_url.rstrip('/')}/.erasures"
        return self.erasure_url or f"file://{self.data_dir.absolute() / 'erasures'}"

    @property
    def is_embedded(self) -> bool:
        """Return whether the database is SQLite: one machine, workers use file locks, `tada serve` runs a worker."""
        return self.resolved_database_url.startswith("sqlite")
