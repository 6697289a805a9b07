"""How sure each name is: held-out data, where the gap lies, the verdict and its words."""
