"""Events: what participants and reviewers say of a meal, the queue of items that wait for a look, questions."""
