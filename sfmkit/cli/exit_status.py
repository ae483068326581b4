"""How a command ends."""

OK = 0
UNTRUSTWORTHY = 1  # ran, but found no trustworthy result; the report says why
BAD_INPUT = 2  # or wrong usage
INTERRUPTED = 130
