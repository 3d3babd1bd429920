"""Conformance kit: whether an app, or a server, keeps to what docs/apps.md asks for (docs/conformance.md).

`observer.py` stands around the real server and records what each phone does; `checks/` judges a recorded conversation;
`phone.py` plays a phone against another server. The commands are in `app/cli`.
"""
