"""Conformance kit: whether an app, or a server, keeps to what docs/apps.md asks for (docs/conformance.md).

`observer.py` stands around the real server and records what each phone does; `app_checks.py` judges a recorded
conversation. `server_phone.py` plays a phone against another server; `server_checks.py` judges that. The commands are
in `app/cli`.
"""
