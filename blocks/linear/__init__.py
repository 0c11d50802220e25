"""Linear models of Plans, their margins and figures; describing functions. python-control's only door."""
