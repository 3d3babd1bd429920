"""Two reviewers decide an item without seeing each other; a third decides where they differ; how far all agree."""
