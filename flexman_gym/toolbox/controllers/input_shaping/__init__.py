"""Input shaping: impulse sequences for the convolution of commands, and controllers with a shaped command."""
