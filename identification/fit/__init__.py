"""Fine-tuning of all parameters on records: the problem, three solvers, and the uncertainty of the solution."""
