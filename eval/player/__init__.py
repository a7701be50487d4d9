"""The player: a log's runs packed into one page that plays them in a browser, without a server."""
