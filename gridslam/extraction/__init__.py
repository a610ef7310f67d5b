"""From sampled signals to paths: the front end that feeds methods on path measurements."""
