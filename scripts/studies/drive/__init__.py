"""Real-time loops of an agent and a simulated machine: settling, deadlines, faults, and a fit of their logs"""
