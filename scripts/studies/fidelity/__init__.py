"""Accuracy and cost of the models chosen by `choose_model`."""
