"""Results in the forms that other software takes."""
