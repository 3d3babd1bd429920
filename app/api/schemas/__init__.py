"""What goes over the wire, in and out: pydantic models, units in the names."""
