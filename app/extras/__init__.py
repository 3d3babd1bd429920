"""Side features that the server runs as well without.

fhir: records as FHIR resources; reminders: Web Push; sandbox: answers that the author of an app asks for; conformance:
judging apps and servers. Each is registered by one line in app/main.py, app/worker.py or app/cli, and imports no other
one; the rest of the program imports none of them.
"""
