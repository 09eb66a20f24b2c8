"""What vehicles carry to sense with, and its faults."""
