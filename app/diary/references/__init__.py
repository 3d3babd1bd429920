"""A study's own days against a reference: weighed records or recalls that an owner uploads as CSV."""
