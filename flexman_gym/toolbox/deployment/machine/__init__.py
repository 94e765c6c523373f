"""Machines: protocol, UDP packets, simulated machine, and the real-time loop of `flexman drive`."""
