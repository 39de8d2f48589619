"""A person, or a file in place of one, drives the deployment controller on a simulated robot."""
