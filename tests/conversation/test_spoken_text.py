"""Text of a model, converted for speech."""

import random

import pytest

from caris_desktop.conversation.spoken_text import spoken


@pytest.mark.parametrize(
    ("written", "said"),
    [
        ("**The lab** closes at *six*.\n\n- Bring `your card`\n- Ask", "The lab closes at six. Bring your card. Ask"),
        ("# The lab\n\nIt is ***old*** and ~~new~~.\n---\n> Mind it!", "The lab. It is old and new. Mind it!"),
        ("1. One\n2) Two\n(3) Three", "One. Two. Three"),
        ("| Day | Opens |\n|:---|---:|\n| Monday | nine |", "Day Opens. Monday nine"),
        ("```\nprint\n```", "print"),
        ("See the [desk](https://lab.example/a_b) or ![a plan](http://x/y.png) [^1].", "See the desk or a plan."),
        ("<p>It <b>stops</b>.</p><img src='/dev/zero'>", "It stops."),
        ("&lt;img src=x&gt;Tom &amp; Jerry", "Tom & Jerry"),
        ("Hello! \U0001f60a\u2764\ufe0f", "Hello!"),
        ("<think>Secret.</think>Hello.", "Hello."),
        ("Hello.<|im_end|>", "Hello."),
        ("5 * 3 is 15, C# is no. 1, snake_case, x < y, 3 > 2", "5 × 3 is 15, C# is no. 1, snake_case, x < y, 3 > 2"),
        ("Hello {p-1f}, \u202egood\x07 day", "Hello {p-1f}, good day"),
        # As some models begin and quote
        ("Robot: It closes at six.", "It closes at six."),
        ('**Assistant:** "It closes at six."', "It closes at six."),
        ('"Yes," she said, "at six."', '"Yes," she said, "at six."'),
        ("It closes at six.\n\n**User:** And then?\nAssistant: It opens at nine.", "It closes at six."),
        # Sources, links and their definitions
        ("At six[1][2], see [this][3].\n\n[3]: https://lab.example 'Lab'", "At six, see this."),
        ("At six 【4†source】.[^1]\n\n[^1]: The web page.", "At six. The web page."),
        ("See [Foo](https://lab.example/Foo_(bar)) and [it](https://lab.example 'Title').", "See Foo and it."),
        # Formulas
        (r"It is \(5 \text{km}\), or $\frac{1}{2}x^2$: \[\boxed{6 \times 7}\]", "It is 5 km, or 1/2x²: 6 × 7"),
        ("It costs $5 or $6.", "It costs $5 or $6."),
        # Numbers of a list, and others
        ("3. Stock, links.", "3. Stock, links."),
        ("5. Mai", "5. Mai"),
        ("▪ One\n◦ Two → three ⏰", "One. Two three"),
        (r"One\n\n- Two", "One. Two"),
        ("&lt;think&gt;Secret.&lt;/think&gt;Hello.", "Hello."),
        ("Six.\n```tool_code\nprint(search())\n```", "Six."),
        ("***", ""),
        ("", ""),
    ],
)  # fmt: skip
def test_signs_that_a_voice_would_read_out_are_gone(written: str, said: str) -> None:
    assert spoken(written) == said
    assert spoken(spoken(written)) == spoken(written)


def test_nothing_of_generated_markup_is_left_and_nothing_takes_long() -> None:
    chance = random.Random(25)  # noqa: S311 - a test, not cryptography
    parts = [
        "**", "*", "_", "`", "~~", "<b>", "</b>", "<img src='/dev/zero'>", "<!--", "-->", "[", "](", ")", "|", "ftp://x.y",
        "\n", "# ", "- ", "word", " ", "<script>", "&lt;b&gt;", "<think>", "</think>", "12.", "\\",
    ]  # fmt: skip
    for _ in range(2000):
        text = spoken("".join(chance.choices(parts, k=chance.randint(1, 40))))
        assert not any(sign in text for sign in ("`", "**", "<b>", "<img", "https:", "<think", "\n", "|")), text
    for part in (
        *parts,
        "[1]",
        "[^",
        "](<",
        "](a(",
        "【",
        "$",
        "$x",
        "\\frac{",
        "\\text{",
        "x^2",
        "&lt;",
        "'",
        "Robot:",
    ):
        spoken(part * (20_000 // len(part)))
