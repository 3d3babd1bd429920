"""The `tada` command: one file per group of commands, and the servers and demos that it starts.

A command reads its arguments, calls one use case and prints the result. Rules belong to the
domains.
"""
