"""Identification: estimation of the physical parameters of an arm from measurements."""
