"""The HTML report's page: a section a module, its template of the same name beside it in ``templates/``."""
