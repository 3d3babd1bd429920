"""A server tells one version everywhere."""

import app


def test_server_api_document_and_fhir_tell_the_program_s_version(client):
    told = (
        client.get("/v1/server").json()["version"],
        client.get("/openapi.json").json()["info"]["version"],
        client.get("/fhir/metadata").json()["software"]["version"],
    )
    assert set(told) == {app.__version__}
