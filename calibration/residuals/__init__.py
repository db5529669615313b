"""What the parameters leave, learnt from joints to pose errors, and the gate that says whether it pays."""
