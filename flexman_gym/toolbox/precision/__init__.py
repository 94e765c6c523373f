"""Speed against accuracy: runs of a scene with error and cost, by our methods and by other simulators."""
