"""A qrsim that hears Ctrl-C in every test."""

# Restores Ctrl-C, which a child of a background process inherits as ignored; for ``python -c``.
INTERRUPTIBLE = (
    "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler);"
    " from qrsim.cli import main; sys.exit(main(sys.argv[1:]))"
)
