"""Messages of the representations that the papers published: particles of agent and features, each apart."""
