"""A file of rows that lies in the blob store, as the API gives it out."""

from collections.abc import Generator
from dataclasses import dataclass

from app.storage.blob_store import BlobStore


@dataclass(frozen=True, slots=True)
class StoredFile:
    """A file that the caller may fetch. length: bytes of it; sha256: of all of them."""

    name: str
    length: int
    sha256: str
    blob_key: str

    def pieces(self, blobs: BlobStore, start: int, length: int) -> Generator[bytes, None, None]:
        """So many bytes from there on. Raises BlobMissingError."""
        if (start, length) == (0, self.length):
            return blobs.stream(self.blob_key)
        return blobs.stream_part(self.blob_key, start, length)
