"""Whether a random disturbance alone explains the misfit, and what one costs beside a cause."""
