"""SHA-256 of the C library: the examples of FIPS 180-4, and Python's for every length about a block's end."""

import hashlib
import subprocess

import pytest
from native_library import NATIVE

EXAMPLES = {
    "": "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855",
    "abc": "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad",
    "abcdbcdecdefdefgefghfghighijhijkijkljklmklmnlmnomnopnopq": (
        "248d6a61d20638b8e5c026930c3e6039a33ce45964ff2167f6ecedd419db06c1"
    ),
}


@pytest.fixture(scope="module")
def sha256(tmp_path_factory):
    """Digests of texts, by the C++ code."""
    program = tmp_path_factory.mktemp("sha256") / "sha256"
    sources = (NATIVE.parent / "tests" / "native" / "sha256_test.cpp", NATIVE / "src" / "file_format" / "sha256.cpp")
    subprocess.run(
        ["c++", "-std=c++17", "-O1", "-Wall", "-Werror", "-I", NATIVE / "src", *sources, "-o", program], check=True
    )
    return lambda *texts: subprocess.run([program, *texts], check=True, capture_output=True, text=True).stdout.split()


def test_the_standards_examples(sha256):
    assert sha256(*EXAMPLES) == list(EXAMPLES.values())


def test_every_length_about_a_blocks_end(sha256):
    texts = ["x" * length for length in range(1, 200)]
    assert sha256(*texts) == [hashlib.sha256(text.encode()).hexdigest() for text in texts]
