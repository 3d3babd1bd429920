"""Creating and correcting foods: each change is a new version with its author and reason."""
