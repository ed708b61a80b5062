"""A game that shows how to read samples: roll the boulder over the huts. It needs the package pygame.

`python -m spheremouse.commands.demo.boulder` takes the ball of the running service.
"""

import random
from collections.abc import Iterable

import pygame

import spheremouse as sm

ROLL = 120.0  # px per radian of the ball


def play(samples: Iterable[sm.Sample], seed: int = 0) -> int:
    """Play until the samples end or the window is closed. Return the number of huts that the boulder hit."""
    rng, hits, screen = random.Random(seed), 0, pygame.display.set_mode((800, 600))
    boulder, hut = pygame.Vector2(400, 300), pygame.Vector2(600, 300)
    for sample in samples:
        if pygame.event.get(pygame.QUIT):
            break
        turn_x, _, turn_z = sample.increment  # zero if the ball is not tracked
        boulder += ROLL * pygame.Vector2(turn_z, -turn_x)  # for a player on the far side of the ball
        boulder.update(boulder.x % 800, boulder.y % 600)  # a boulder that leaves comes back at the other edge
        if boulder.distance_to(hut) < 40:
            hits, hut = hits + 1, pygame.Vector2(rng.uniform(50, 750), rng.uniform(50, 550))
        screen.fill("bisque")
        pygame.draw.rect(screen, "firebrick", (hut - (15, 15), (30, 30)))
        pygame.draw.circle(screen, "gray55", boulder, 40)
        for x, y, z in (*sample.rotation.T, *-sample.rotation.T):  # six places on the ball, seen from above
            pygame.draw.circle(screen, "gray25", boulder - 32 * pygame.Vector2(x, z), 7 if y > 0 else 0)
        pygame.display.set_caption(f"{hits} huts, {sample.status}")
        pygame.display.flip()
    pygame.quit()
    return hits


if __name__ == "__main__":
    print(f"huts hit: {play(sm.connect())}")
