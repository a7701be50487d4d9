"""The player: a log's runs packed into one web page, without a server."""
