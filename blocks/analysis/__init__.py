"""Analysis of diagrams in the frequency domain."""
