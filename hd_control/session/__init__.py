"""Running nodes seen from outside: start them, wait, send goals, apply a model, publish a recording."""
