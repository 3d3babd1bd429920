"""Review: events of participants and reviewers about meals, the queue of items to review, questions."""
