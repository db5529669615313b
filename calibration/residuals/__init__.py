"""Residuals beyond the parameters, learnt from joints to pose errors, and the gate that says whether they pay."""
