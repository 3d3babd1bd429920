"""`tada doctor`: report a deployment's problems in sentences."""
