"""report.html: a static page that explains a batch, with no network and no server."""
