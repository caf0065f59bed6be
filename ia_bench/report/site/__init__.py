"""The report as a page: one folder with an ``index.html`` that a double click opens, without a server or a network.

``content.py`` gathers what it says, ``write.py`` fills ``templates/`` and puts the parts that load late beside it.
"""
