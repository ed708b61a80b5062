"""A game that shows how to read samples: roll the boulder over the huts. It needs the package pygame.

It takes the ball of the running service. If there is none, a simulated ball plays for 30 s.
"""

import random
from collections.abc import Iterable, Iterator

import pygame

import spheremouse as sm
from spheremouse.errors import ControlError

RADIUS, ROLL = 40, 120.0  # px, px per radian of the ball
SAND, STONE, DARK, HUT = "bisque", "gray55", "gray25", "firebrick"


def play(samples: Iterable[sm.Sample], seed: int = 0) -> int:
    """Play until the samples end or the window is closed. Return the number of huts that the boulder hit."""
    rng, hits = random.Random(seed), 0
    pygame.display.init()
    pygame.font.init()
    screen, font = pygame.display.set_mode((800, 600)), pygame.font.Font(None, 48)
    pygame.display.set_caption("Boulder")
    edge = pygame.Vector2(screen.get_size())
    boulder, hut = edge / 2, pygame.Vector2(600, 300)
    for sample in samples:
        if pygame.event.get(pygame.QUIT):
            break
        turn_x, _, turn_z = sample.increment  # zero if the ball is not tracked
        boulder += ROLL * pygame.Vector2(turn_z, -turn_x)  # for a player on the far side of the ball
        boulder.update(boulder.x % edge.x, boulder.y % edge.y)  # a boulder that leaves comes back at the other edge
        if boulder.distance_to(hut) < RADIUS:
            hits, hut = hits + 1, pygame.Vector2(rng.uniform(50, edge.x - 50), rng.uniform(50, edge.y - 50))
        screen.fill(SAND)
        pygame.draw.rect(screen, HUT, (hut - (15, 15), (30, 30)))
        pygame.draw.circle(screen, STONE, boulder, RADIUS)
        for x, y, z in (*sample.rotation.T, *-sample.rotation.T):  # six places on the ball, seen from above
            if y > 0.0:
                pygame.draw.circle(screen, DARK, boulder - 0.8 * RADIUS * pygame.Vector2(x, z), 7)
        screen.blit(font.render(f"{hits} huts   {sample.status}", True, DARK), (10, 10))
        pygame.display.flip()
    pygame.quit()
    return hits


def samples(film: str = "synthetic:motion=play,seconds=30,noise=4") -> Iterator[sm.Sample]:
    """Yield the samples of the running service, else those of a simulated camera."""
    live = sm.connect()
    try:
        yield next(live)
    except ControlError:
        with sm.open_source(film, realtime=True) as source:
            yield from sm.track(source)
    else:
        yield from live


if __name__ == "__main__":
    print(f"huts hit: {play(samples())}")
