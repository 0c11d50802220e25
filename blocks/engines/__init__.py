"""What runs Plans: the reference engine, the native one, and the master of co-simulation."""
