"""`tada doctor`: what is wrong with a deployment, in sentences."""
