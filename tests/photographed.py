"""Pictures shown to the judge of photos, as a person shows them."""


def resumed(judge, *pictures):
    """The judge, to whom pictures taken before are known."""
    for image in pictures:
        assert judge.resume(lambda image=image: image)
    return judge


def looked(judge, image, times=2):
    """A picture that rests for some frames."""
    for _ in range(times):
        look = judge.look(image)
    return look
