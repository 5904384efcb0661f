"""Search: planners see functions and arrays, never a model class, so a toy world tests them."""
