"""Small folders of text files to replace, as they are and as they should become."""

from pathlib import Path

OLD_MODEL = {"cameras.txt": "c", "images.txt": "i", "points3D.txt": "p", "rigs.txt": "r"}
FOREIGN = {"project.ini": "ini", "points3D.ply": "ply", "images/a.jpg": "jpg"}
NEW_MODEL = {"cameras.bin": "C", "images.bin": "I", "points3D.bin": "P", "frames.bin": "F"}


def write_tree(folder: Path, files: dict[str, str]) -> Path:
    for name, content in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(content)
    return folder


def tree(folder: Path) -> dict[str, str]:
    """Every file below the folder, hidden and temporary ones too."""
    files = (path for path in sorted(folder.rglob("*")) if path.is_file())
    return {str(path.relative_to(folder)): path.read_text() for path in files}
