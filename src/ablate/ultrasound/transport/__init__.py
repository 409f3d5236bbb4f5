"""Monte-Carlo transport of rays."""
