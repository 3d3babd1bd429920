"""What only a store elsewhere meets: it is away, slow, set wrongly, or alters bytes. On a server of its own."""

import errno
import os
import pathlib
import signal
import socket
import threading
import time
from dataclasses import replace

import obstore
import pytest

from app.children.faults import is_passing
from app.core.errors import InvalidInputError
from app.core.settings import Settings
from app.storage.blob_store import BlobDamagedError, StoreRefusesError
from app.storage.opening import open_blob_store
from app.storage.s3 import PATIENCE
from tests.support.s3_places import IMPATIENT, s3_place, s3_settings, s3_store
from tests.support.s3_server import S3Server

pytestmark = pytest.mark.slow

KEY = "study/meal/left/0123"
SECRETS = ("study/meal", "SecretAccessKey")
FEW_TRIES = replace(PATIENCE, tries=2)


@pytest.fixture(scope="module")
def own_server(tmp_path_factory):
    server = S3Server.start(tmp_path_factory.mktemp("own") / "s3")
    yield server
    server.stop()


def calls(store, tmp_path):
    """Every call that asks the server, by name."""
    path = tmp_path / "staged"
    path.write_bytes(b"x")
    return {
        "put_file": lambda: store.put_file(KEY, path),
        "put_bytes": lambda: store.put_bytes(KEY, b"x"),
        "read": lambda: store.read(KEY),
        "stream": lambda: store.stream(KEY),
        "fetch": lambda: store.fetch(KEY, tmp_path / "copy"),
        "has": lambda: store.has(KEY),
        "delete": lambda: store.delete(KEY),
        "keys": lambda: list(store.keys("study/")),
        "check": store.check,
    }


def stop(pid):
    """SIGSTOP, and wait until every thread of it stands."""
    os.kill(pid, signal.SIGSTOP)
    states = [path / "stat" for path in pathlib.Path(f"/proc/{pid}/task").iterdir()]
    while any(path.read_text().rpartition(")")[2].split()[0] != "T" for path in states):
        time.sleep(0.01)


def assert_told(call, store, error_type=OSError, number=None):
    """The error waits for better times, has words, and no text of the server's, no key of a blob, no secret."""
    with pytest.raises(error_type) as caught:
        call()
    error = caught.value
    assert is_passing(error)
    assert error.errno == number if number is not None else error.errno is not None
    assert error.strerror
    assert str(store._place.endpoint) not in error.strerror  # /readyz tells these words to anybody
    for text in (*SECRETS, store._place.secret_access_key.get_secret_value(), "<Error>"):
        assert text not in str(error)
    assert error.__cause__ is None
    assert error.__context__ is None or error.__suppress_context__  # else a log's traceback holds the server's text
    return error


def test_stopped_server_is_told_in_bounded_time_and_killed_one_at_once_and_both_work_again(own_server, tmp_path):
    place = s3_place(own_server)
    store = s3_store(own_server, tmp_path / "staging", IMPATIENT, prefix=place.prefix)
    patient = s3_store(own_server, tmp_path / "staging", prefix=place.prefix)  # for what succeeds on a busy machine too
    patient.put_bytes(KEY, b"x")
    stop(own_server.pid)
    try:
        began = time.monotonic()
        for name, call in calls(store, tmp_path).items():
            if name in ("put_file", "read", "check"):
                assert_told(call, store, number=errno.ETIMEDOUT)
        assert time.monotonic() - began < 60  # three calls; no more than a bound, and of minutes' waits
    finally:
        os.kill(own_server.pid, signal.SIGCONT)
    assert patient.read(KEY) == b"x"  # a put that was told as failed may be done later: keys name their content
    own_server.kill()
    for call in calls(store, tmp_path).values():
        assert_told(call, store, number=errno.ECONNREFUSED)
    assert (tmp_path / "staged").exists()  # what was not put is still there
    own_server.start_again()
    assert patient.read(KEY) == b"x"
    for call in calls(patient, tmp_path).values():
        call()


def test_wrong_secret_and_bucket_that_is_not_there_are_told_by_every_call(s3_server, tmp_path):
    good = s3_store(s3_server, tmp_path / "staging")
    good.put_bytes(KEY, b"x")
    wrong = s3_place(s3_server, prefix=good._place.prefix, secret_access_key=Settings(secret_key="w" * 40).secret_key)
    for store, words in (
        (type(good)(wrong, tmp_path / "staging"), "refuses our key (SignatureDoesNotMatch)"),
        (s3_store(s3_server, tmp_path / "staging", bucket="nobodys-bucket"), "the bucket is not there"),
    ):
        for call in calls(store, tmp_path).values():
            assert words in assert_told(call, store, StoreRefusesError).strerror


class Altering:
    """A connection to the server that alters some bytes on the way up or down."""

    def __init__(self, server, *, up=(b"", b""), down=(b"", b"")):
        self._target = server.port
        self._up, self._down = up, down
        self._listening = socket.create_server(("127.0.0.1", 0))
        self.endpoint = f"http://127.0.0.1:{self._listening.getsockname()[1]}"
        self._open = [self._listening]
        threading.Thread(target=self._accept, daemon=True).start()

    def close(self):
        for one in self._open:
            one.close()

    def _accept(self):
        while True:
            try:
                client, _ = self._listening.accept()
            except OSError:
                return
            server = socket.create_connection(("127.0.0.1", self._target))
            self._open += [client, server]
            for source, target, change in ((client, server, self._up), (server, client, self._down)):
                threading.Thread(target=self._pump, args=(source, target, change), daemon=True).start()

    @staticmethod
    def _pump(source, target, change):
        try:
            while data := source.recv(65536):
                target.sendall(data.replace(*change) if change[0] else data)
            target.shutdown(socket.SHUT_WR)
        except OSError:
            return


@pytest.mark.parametrize("length", [1000, 9 * 1024 * 1024])
def test_bytes_altered_on_the_way_up_are_refused_by_the_server(s3_server, tmp_path, length):
    proxy = Altering(s3_server, up=(b"MIDDLE", b"muddle"))
    try:
        place = s3_place(s3_server)
        store = s3_store(s3_server, tmp_path / "staging", FEW_TRIES, endpoint=proxy.endpoint, prefix=place.prefix)
        path = store.staging_folder() / "photo"
        path.write_bytes(b"-" * length + b"MIDDLE" + b"-" * length)
        error = assert_told(lambda: store.put_file(KEY, path), store, number=errno.EIO)
        assert "BadDigest" in error.strerror
        assert path.exists()
    finally:
        proxy.close()
    direct = s3_store(s3_server, tmp_path / "staging", prefix=place.prefix)
    assert not direct.has(KEY)


def test_bytes_altered_on_the_way_down_are_never_given_out_whole(s3_server, tmp_path):
    place = s3_place(s3_server)
    direct = s3_store(s3_server, tmp_path / "staging", prefix=place.prefix)
    content = b"-" * 700_000 + b"MIDDLE" + b"-" * 700_000
    direct.put_bytes(KEY, content)
    proxy = Altering(s3_server, down=(b"MIDDLE", b"muddle"))
    try:
        store = s3_store(s3_server, tmp_path / "staging", endpoint=proxy.endpoint, prefix=place.prefix)
        assert_damaged(store, tmp_path, len(content))
    finally:
        proxy.close()
    assert direct.read(KEY) == content


def test_object_that_changed_in_the_bucket_is_never_given_out_whole(s3_server, tmp_path):
    store = s3_store(s3_server, tmp_path / "staging")
    for content in (b"", b"other bytes", b"-" * 1_400_000):
        digest = "a" * 64  # of other bytes, as a disk that rots leaves it
        obstore.put(store._store, KEY, content, attributes={"sha256": digest})
        assert_damaged(store, tmp_path, max(1, len(content)))


def assert_damaged(store, tmp_path, length):
    for call in (lambda: store.read(KEY), lambda: store.fetch(KEY, tmp_path / "copy")):
        with pytest.raises(BlobDamagedError):
            call()
    given = 0
    with pytest.raises(BlobDamagedError):  # noqa: PT012  # the last piece never comes
        for piece in store.stream(KEY):
            given += len(piece)
    assert given < length


def test_uploads_that_wait_too_long_for_others_are_told_to_come_again(s3_server, tmp_path):
    store = s3_store(s3_server, tmp_path / "staging", replace(PATIENCE, turn_seconds=0.5))
    for _ in range(4):
        store._turns.acquire()
    assert_told(lambda: store.put_bytes(KEY, b"x"), store, number=errno.ETIMEDOUT)
    store._turns.release()
    store.put_bytes(KEY, b"x")


def test_what_is_no_key_of_ours_in_the_bucket_is_not_listed(s3_server, tmp_path):
    store = s3_store(s3_server, tmp_path / "staging")
    store.put_bytes(KEY, b"x")
    for strange in (".probe/left-by-a-killed-process", "a key/with blanks", "study/.hidden"):
        obstore.put(store._store, strange, b"x")
    assert [blob.key for blob in store.keys()] == [KEY]  # noqa: SIM118  # a store is no mapping


def test_bucket_that_keeps_versions_is_found_out(own_server, tmp_path):
    store = s3_store(own_server, tmp_path / "staging")
    store.check()
    assert store.keeps_versions is False
    own_server.keep_versions("versioned")
    store = s3_store(own_server, tmp_path / "staging", bucket="versioned")
    store.check()
    assert store.keeps_versions is True


IMPOSSIBLE = [
    ({"blob_url": "s3://key:secret@bucket/x"}, "nothing else"),
    ({"blob_url": "s3://bucket/x?endpoint=y"}, "nothing else"),
    ({"blob_url": "s3:///prefix"}, "nothing else"),
    ({"blob_url": "gs://bucket"}, "TADA_BLOB_URL"),
    ({"s3_access_key_id": None}, "both or none"),
    ({"s3_secret_access_key": None}, "both or none"),
    ({"s3_endpoint": "s3.example.org"}, "TADA_S3_ENDPOINT"),
    ({"s3_endpoint": "https://s3.example.org/bucket"}, "TADA_S3_ENDPOINT"),
]


def test_setting_that_cannot_work_is_refused_and_the_secret_is_never_printed(s3_server, tmp_path):
    secret, good = s3_server.secret_access_key, s3_settings(s3_server)
    for change, words in IMPOSSIBLE:
        settings = Settings(data_dir=tmp_path, **good | change)
        with pytest.raises(InvalidInputError, match=words) as caught:
            open_blob_store(settings.resolved_blob_url, settings)
        assert caught.value.code == "settings_invalid"
        assert "secret@" not in caught.value.message
        assert secret not in caught.value.message
    settings = Settings(data_dir=tmp_path, **good)
    store = open_blob_store(settings.resolved_blob_url, settings)
    for text in (repr(settings), str(settings.model_dump()), repr(store._place), str(store), repr(store)):
        assert secret not in text
