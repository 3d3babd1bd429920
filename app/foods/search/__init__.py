"""Food search: the index of words, codes and trigrams, and queries over it."""
