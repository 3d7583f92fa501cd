"""What is done with a model and a recording: compare, fit, the error ladder."""
