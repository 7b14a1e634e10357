"""Estimation: filters, regression, recursive least squares, and which model of the load holds."""
