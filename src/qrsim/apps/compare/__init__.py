"""Saying in what two runs differ."""
