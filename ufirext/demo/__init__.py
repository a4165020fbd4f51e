"""A city drive with known truth, lost and late packets, several filters, one report (`ufirext demo`)."""
