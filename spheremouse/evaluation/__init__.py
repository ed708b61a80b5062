"""Evaluation of runs against the truth. Arrays in, numbers out."""
