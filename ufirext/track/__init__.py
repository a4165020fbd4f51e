"""Recorded tracks: read a CSV or GPX file, filter it, write and draw the result (`ufirext track`)."""
