"""Linear systems over frequency: responses, margins, describing functions, figures. Knows no diagram."""
