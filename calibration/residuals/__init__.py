"""Learnt residuals (models of the pose error that the parameters leave), and the gate that accepts or rejects them."""
