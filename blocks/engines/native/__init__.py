"""The native engine: a Plan printed as C, compiled, cached, and run."""
