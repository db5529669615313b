"""From a wanted pose to the joint command that reaches it on the calibrated arm."""
