"""clients/python: when a call is repeated, and downloads that continue where they broke off."""

import http.server
import threading

import pytest
from tada_client import NetworkError, Phone, Problem, RetryPolicy, Staff
from tada_client.caller import path_of
from tada_client.retries import is_transient, retry_after_seconds

POLICY = RetryPolicy(attempts=4, first_seconds=1, longest_seconds=5, random=lambda: 0.5)
LOST = NetworkError("lost")
CONTENT = bytes(range(256)) * 40


def test_passing_faults_alone_are_repeated_after_pauses_that_double_with_retry_after_as_a_lower_bound():
    longest = RetryPolicy(attempts=9, first_seconds=1, longest_seconds=5, random=lambda: 1.0)
    assert [longest.seconds_until_next(LOST, attempt) for attempt in (1, 2, 3, 4, 5)] == [1, 2, 4, 5, 5]
    assert POLICY.seconds_until_next(LOST, 2) == 1
    assert POLICY.seconds_until_next(LOST, 4) is None
    assert POLICY.seconds_until_next(Problem(503, None, 3), 1) == 3.5
    assert POLICY.seconds_until_next(Problem(503, None, 6), 1) is None
    assert all(is_transient(Problem(status)) for status in (408, 425, 429, 500, 502, 503, 504))
    assert not any(is_transient(Problem(status)) for status in (400, 401, 404, 409, 410, 412, 422, 501))
    assert not is_transient(Problem(500, {"code": "blob_missing", "retryable": False}))
    assert not is_transient(Problem(409, {"code": "clock_differs", "retryable": True}))


def test_retry_after_is_read_as_seconds_and_as_a_date_by_the_answers_own_clock():
    date = "Fri, 20 Nov 2026 12:00:30 GMT"
    assert retry_after_seconds({"Retry-After": "7"}) == 7
    assert retry_after_seconds({"Retry-After": date, "Date": "Fri, 20 Nov 2026 12:00:20 GMT"}) == 10
    assert retry_after_seconds({"Retry-After": date}, now=1_795_176_000.0) == 30
    assert retry_after_seconds({"Retry-After": date}, now=1_900_000_000.0) == 0
    assert [retry_after_seconds({"Retry-After": text}) for text in ("", "soon", "-3", "1.5", "soon GMT")] == [None] * 5


def test_addresses_and_ids_that_would_lead_elsewhere_are_refused():
    for server in ("tada.example.org", "https://me:pw@host", "https://host?x=1", "ftp://host"):
        with pytest.raises(ValueError, match="No address"):
            Phone(server)
    assert path_of("meals", "../me?x#y") == "/v1/meals/..%2Fme%3Fx%23y"
    with pytest.raises(ValueError, match="No part"):
        path_of("meals", "..")


class Files(http.server.BaseHTTPRequestHandler):
    """Gives a file; the first answer breaks off in the middle."""

    protocol_version = "HTTP/1.1"

    def do_GET(self):
        asked = self.headers.get("Range"), self.headers.get("If-Range")
        self.server.asked.append(asked)
        start = int(asked[0].removeprefix("bytes=").rstrip("-")) if asked[0] and self.server.takes_ranges else 0
        self.send_response(206 if start else 200)
        self.send_header("Content-Length", str(len(CONTENT) - start))
        if self.server.takes_ranges:
            self.send_header("Accept-Ranges", "bytes")
            self.send_header("ETag", '"abc"')
        self.end_headers()
        whole = CONTENT[start:]
        self.wfile.write(whole[: len(CONTENT) // 2] if len(self.server.asked) == 1 else whole)
        self.close_connection = len(self.server.asked) == 1

    def log_message(self, *_):
        pass


@pytest.mark.parametrize("takes_ranges", [True, False])
def test_broken_download_is_whole_in_the_end_and_continues_where_the_server_can(tmp_path, takes_ranges):
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Files) as server:
        server.asked, server.takes_ranges = [], takes_ranges
        threading.Thread(target=server.serve_forever, daemon=True).start()
        with Staff(f"http://127.0.0.1:{server.server_port}", "t", retries=RetryPolicy(first_seconds=0)) as staff:
            saved = staff.download("/v1/records", tmp_path / "records.csv")
        server.shutdown()
    assert saved.read_bytes() == CONTENT
    assert [path.name for path in tmp_path.iterdir()] == ["records.csv"]
    assert len(server.asked) == 2
    first, second = server.asked
    assert first == (None, None)
    assert second == ((f"bytes={len(CONTENT) // 2}-", '"abc"') if takes_ranges else (None, None))
