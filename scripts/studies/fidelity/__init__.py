"""Fidelity: are the choices of models right, and are they cheap?"""
