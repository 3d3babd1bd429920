"""Backups taken apart and put together again with something changed: checksums, counts and seal as if nothing were."""

import gzip
import hashlib
import io
import json
import tarfile
from dataclasses import dataclass, field

from app.operations.backup.backup_format import END, LACKING, MANIFEST, SUMS, End
from app.operations.backup.backup_tar import TarWriter


@dataclass
class Forgery:
    """A backup's members in their order, to be changed at will; `to_bytes` seals them again."""

    members: list[tuple[str, bytes]]
    end: dict = field(default_factory=dict)

    @classmethod
    def of(cls, path):
        with tarfile.open(path) as tar:
            members = [(one.name, tar.extractfile(one).read()) for one in tar]
        end = json.loads(dict(members)[END])["contents"]
        return cls([(name, content) for name, content in members if name not in (SUMS, END)], end)

    def names(self):
        return [name for name, _ in self.members]

    def place(self, prefix):
        return next(number for number, name in enumerate(self.names()) if name.startswith(prefix))

    def change(self, prefix, change):
        """The first member whose name begins so gets other content."""
        place = self.place(prefix)
        name, content = self.members[place]
        self.members[place] = (name, change(content))

    def add_blob(self, name, content):
        """After the others, and counted."""
        self.members.insert(self.place(LACKING), (name, content))
        self.end["blobs"] += 1
        self.end["blob_bytes"] += len(content)

    def change_manifest(self, **fields):
        self.change(MANIFEST, lambda content: json.dumps(json.loads(content) | fields).encode())

    def change_rows(self, table, change):
        """change: from the list of rows, each a list of values, to another."""

        def changed(content):
            rows = [json.loads(line) for line in gzip.decompress(content).splitlines()]
            rows = change(rows)
            self.end["rows"][table] = len(rows)
            return gzip.compress(b"".join(json.dumps(row).encode() + b"\n" for row in rows))

        self.change(f"tables/{table}/", changed)

    def change_value(self, table, column, value):
        """Another value in the first row."""
        names = [name for name, _ in json.loads(dict(self.members)[MANIFEST])["tables"][table]]

        def changed(rows):
            rows[0][names.index(column)] = value
            return rows

        self.change_rows(table, changed)

    def to_bytes(self, box):
        out, sums = io.BytesIO(), io.BytesIO()
        tar = TarWriter(out, sums, 0)
        for name, content in self.members:
            tar.add_bytes(name, content)
        count, text = tar.members, sums.getvalue()
        tar.add_bytes(SUMS, text)
        told = {"members": count, "sums_sha256": hashlib.sha256(text).hexdigest()}
        tar.add_bytes(END, End(**{name: (self.end | told)[name] for name in End.model_fields}).to_bytes(box))
        tar.close()
        return out.getvalue()
