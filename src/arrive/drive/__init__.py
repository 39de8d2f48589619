"""Driving the deployment controller on a simulated robot, with a gamepad or a script."""
