#pragma once

/// Messages about tracks and keypoints that contradict each other. They describe an element of a
/// track, after "point 3: ", or a keypoint that is in no track.

#include <cstdint>
#include <string>

#include "core/io/colmap_index.h"
#include "core/words.h"

namespace bundle {

inline std::string NoSuchImage(const ColmapIndex::TrackElement& element) {
  return "expected an image of the model in the track, found " +
         RecordName("image", element.image_id);
}

inline std::string NoSuchKeypoint(const ColmapIndex::TrackElement& element,
                                  const ColmapIndex::Image& image) {
  return "expected one of " + Counted(image.num_keypoints, "keypoint") + " of " +
         RecordName("image", image.id) + " in the track, found " +
         RecordName("keypoint", element.keypoint);
}

/// `point_id`: the point to which the keypoint refers.
inline std::string RefersElsewhere(const ColmapIndex::TrackElement& element, uint64_t point_id) {
  return "expected " + RecordName("keypoint", element.keypoint) + " of " +
         RecordName("image", element.image_id) + " to refer back to it, found " +
         (point_id == kInvalidPoint3DId ? "no point" : RecordName("point", point_id));
}

inline std::string VisitedAgain(const ColmapIndex::TrackElement& element) {
  return "expected each keypoint once in the track, found " +
         RecordName("keypoint", element.keypoint) + " of " + RecordName("image", element.image_id) +
         " again";
}

inline std::string NotInTrack(const ColmapIndex::Image& image, uint64_t keypoint,
                              uint64_t point_id) {
  return RecordName("image", image.id) + ", " + RecordName("keypoint", keypoint) +
         ": expected a point with this keypoint in its track, found " +
         RecordName("point", point_id);
}

}  // namespace bundle
