"""A study's vessel library: mugs and bowls measured once, and their use in estimates."""
