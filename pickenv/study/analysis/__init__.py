"""What a study says: sensitivities, figures, report, recording."""
