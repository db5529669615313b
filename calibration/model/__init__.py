"""What is measured and what is fitted: measurements, the arm's error model, its parameters and what data tell of them."""
