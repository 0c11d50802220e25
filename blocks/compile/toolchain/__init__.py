"""C texts -> libraries: the compiler, its cache, and other platforms."""
