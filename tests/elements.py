"""A page of HTML as its elements and words."""

from html.parser import HTMLParser


class Elements(HTMLParser):
    """All elements of a page, the values of their attributes, and its words; fails where elements do not nest."""

    def __init__(self, text):
        super().__init__()
        self.open, self.tags, self.values, self.links, self.words = [], [], [], [], ""
        self.feed(str(text))
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.handle_startendtag(tag, attrs)
        if tag not in {"meta", "img", "br"}:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.tags.append(tag)
        self.values += [value for _, value in attrs]
        self.links += [value for key, value in attrs if key in {"src", "href", "xlink:href"}]

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.words += data
