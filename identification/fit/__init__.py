"""Fine-tuning of all parameters on records: the problem, three ways to solve it, how uncertain the solution is."""
