"""The probe in a browser: a core that knows no page, and its skin in `page`."""
