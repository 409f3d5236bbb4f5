"""How far the numbers can be trusted: error against run time, and stiff and extreme cases."""
