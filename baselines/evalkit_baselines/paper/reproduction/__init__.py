"""The paper, reproduced: each of its tables, figures and claims beside what this software measures."""
