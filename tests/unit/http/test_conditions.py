import pytest

from app.core.errors import MalformedRequestError
from app.http.parameters import expected_versions


@pytest.mark.parametrize(
    ("if_match", "versions"),
    [('"24"', {24}), (' "1", "2" ', {1, 2}), ('W/"3"', set()), ('"no version of ours"', set()), ("*", None)],
)
def test_tags_name_versions_and_those_that_no_version_has_name_none(if_match, versions):
    assert expected_versions(if_match) == versions


@pytest.mark.parametrize("if_match", ["24", '"24', '24, "24"', ""])
def test_tag_without_its_quotes_is_told_so_and_is_no_stale_one(if_match):
    with pytest.raises(MalformedRequestError, match="with its quotes"):
        expected_versions(if_match)
