"""What is measured and what is fitted: measurements, the arm's error model, and what data tell of its parameters."""
