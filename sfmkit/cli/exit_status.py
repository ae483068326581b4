"""Exit statuses of the commands; docs/commands.md describes them."""

__all__ = ["BAD_INPUT", "CRASHED", "INTERRUPTED", "OK", "UNTRUSTWORTHY"]

OK = 0
UNTRUSTWORTHY = 1  # no trustworthy result; the report states the reason
BAD_INPUT = 2  # bad input, wrong usage, or an output that cannot be written
CRASHED = 70  # a fault of sfmkit; EX_SOFTWARE of sysexits.h
INTERRUPTED = 130  # Ctrl-C; 128 + n for other signals: 129 for SIGHUP, 143 for SIGTERM
