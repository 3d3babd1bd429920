"""Running the server: preparing a deployment, health, metrics, chores of workers."""
