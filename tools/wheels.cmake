# The ROS wheels of PyPI export include folders of the machine that built them (/opt/python/...), and CMake refuses to
# link against a target whose include folders do not exist. Given with -DCMAKE_PROJECT_INCLUDE=, this file drops such
# folders from every imported target once the project's own CMakeLists.txt has been read. A ROS installation needs none
# of this.
include_guard(GLOBAL)

function(pkm_cnc_drop_missing_include_folders)
  get_property(targets DIRECTORY "${CMAKE_SOURCE_DIR}" PROPERTY IMPORTED_TARGETS)
  foreach(target IN LISTS targets)
    get_target_property(folders "${target}" INTERFACE_INCLUDE_DIRECTORIES)
    if(folders)
      list(FILTER folders EXCLUDE REGEX "^/opt/python/")
      set_target_properties("${target}" PROPERTIES INTERFACE_INCLUDE_DIRECTORIES "${folders}")
    endif()
  endforeach()
endfunction()

cmake_language(DEFER DIRECTORY "${CMAKE_SOURCE_DIR}" CALL pkm_cnc_drop_missing_include_folders)
