"""The numerical validation suite: every table and figure of the four papers, claim by claim."""
