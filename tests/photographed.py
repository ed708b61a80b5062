"""Pictures shown to the selector of photos, as a person shows them."""


def resumed(selector, *pictures):
    for image in pictures:
        assert selector.resume(lambda image=image: image)
    return selector


def looked(selector, image, times=2):
    for _ in range(times):
        check = selector.check(image)
    return check
