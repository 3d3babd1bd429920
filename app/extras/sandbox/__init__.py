"""Sandbox studies: answers that an app's author asks for, to see what the app does with them (docs/sandbox.md).

What a sandbox study is, belongs to people (it is a kind of study), how long its data stay, to privacy.
"""
