"""Measurements of accuracy, time, memory and size, against known truths and other programs' figures.

``python -m benchmarks --data DIR`` runs all of them for which DIR holds the scans.
"""
