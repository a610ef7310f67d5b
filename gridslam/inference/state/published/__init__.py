"""The states that the papers published: particles of agent and features, each apart."""
