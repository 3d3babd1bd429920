import pytest

from app.core.settings import Settings


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("TADA_SECRETS_DIR", str(tmp_path))
    return tmp_path


def test_setting_in_a_file_counts_behind_a_variable_and_a_folder_that_is_not_there_is_an_error(folder, monkeypatch):
    (folder / "tada_secret_key").write_text("k" * 40 + "\n")
    (folder / "TADA_MAX_UPLOADS").write_text("7")
    settings = Settings()
    assert (settings.secret_key.get_secret_value(), settings.max_uploads) == ("k" * 40, 7)
    (folder / "tada_port").write_text("1")
    monkeypatch.setenv("TADA_PORT", "2")
    assert Settings().port == 2
    assert Settings(port=3).port == 3
    monkeypatch.setenv("TADA_SECRETS_DIR", str(folder / "nowhere"))
    with pytest.raises(NotADirectoryError, match="nowhere"):
        Settings()


def test_password_of_its_own_goes_into_the_url_in_its_escaped_form_unless_there_is_one(folder):
    url = "postgresql://tada@db.example.org:5432/tada?sslmode=verify-full"
    settings = Settings(database_url=url, database_password="a/b@c:d %")
    assert settings.resolved_database_url == url.replace("tada@", "tada:a%2Fb%40c%3Ad%20%25@", 1)
    assert "a/b" not in repr(settings)
    (folder / "tada_database_password").write_text("other")
    settings = Settings(database_url="postgresql://tada:mine@db/tada")
    assert settings.resolved_database_url == "postgresql://tada:mine@db/tada"
