"""A flat model -> the Plan, its derivatives and bindings, and its C."""
