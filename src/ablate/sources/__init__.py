"""Where the pairs of a study come from: one protocol, and a module of `kinds` for each file of conf/scene."""
