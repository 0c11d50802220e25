"""Linear models of Plans, operating points, harmonic balance and limit cycles."""
