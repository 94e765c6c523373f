"""The paper's arm in other simulators."""
